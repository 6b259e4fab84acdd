"""Conversion of the first convolution from BGR to RGB."""

import torch
import torch.nn.functional as F

from benchmarks.vgg_from_hed import MEAN_BGR, MEAN_RGB, to_rgb


def test_the_converted_kernels_see_rgb_as_the_originals_see_bgr():
    torch.manual_seed(0)
    kernel, bias = torch.randn(5, 3, 3, 3).double(), torch.randn(5).double()
    rgb = torch.rand(1, 3, 8, 9).double()
    bgr = 255 * rgb.flip(1) - torch.tensor(MEAN_BGR)[:, None, None]
    ours = 255 * (rgb - torch.tensor(MEAN_RGB)[:, None, None])
    torch.testing.assert_close(
        F.conv2d(ours, *to_rgb(kernel, bias)), F.conv2d(bgr, kernel, bias), atol=1e-3, rtol=1e-5
    )
