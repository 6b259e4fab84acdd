"""Data sets and recordings: KITTI's formats, own recordings, imports, checks of all of them."""
