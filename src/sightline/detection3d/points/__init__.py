"""Two-stage design on points after Shi et al. 2019 (PointRCNN), with PointNet++ as backbone."""
