"""Network of Kim et al. 2018 (DGFN): two VGG16 streams, gated fusion, SSD's heads."""
