"""Files of the frames in the folders of a data set, without reading them."""
