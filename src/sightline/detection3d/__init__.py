"""Two-stage detection of road users in 3D from LiDAR: proposals from points, then refinement."""
