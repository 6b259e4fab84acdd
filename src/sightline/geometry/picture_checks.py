"""Doubts about pictures. Without PyTorch."""

from typing import Final

GREY_DOUBT: Final = (
    "images are grey: their level is used for red, green and blue; the shipped networks are "
    "trained on colour images, so give those if there are any"
)
"""Warning of images in shades of grey."""
