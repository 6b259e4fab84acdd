"""Files in and out, in KITTI's formats, and the data sets over them."""
