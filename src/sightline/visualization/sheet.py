"""Page with a frame's data, labels and predictions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor

from sightline.geometry.projection import sparse_depth_map
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.labels import ObjectLabels
from sightline.structures.level import level_view
from sightline.structures.objects import Objects
from sightline.structures.predictions import (
    DepthMap,
    Detections2D,
    Detections3D,
    FurtherPrediction,
    Perception,
)
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye, put_boxes_from_above
from sightline.visualization.canvas import scaled_into
from sightline.visualization.cells import MUTED, PAGE, TITLE
from sightline.visualization.colors import (
    DEPTH_SCALE,
    ERROR_SCALE,
    INVALID,
    RGB,
    UNCERTAINTY_SCALE,
    ColorScale,
)
from sightline.visualization.depth import colorize_depth, colorize_error, draw_depth, put_legend
from sightline.visualization.image import (
    camera_picture,
    draw_boxes2d,
    draw_boxes3d,
    draw_detections,
    draw_points,
)
from sightline.visualization.lettering import put_text, text_width
from sightline.visualization.object_table import draw_object_table
from sightline.visualization.objects import OBJECTS_LEGEND, box_styles, draw_objects
from sightline.visualization.zoom import zoomed

_LABEL_BESIDE_DETECTION: RGB = (245, 245, 245)
_COLUMN_PX = 1242  # KITTI's pictures at their own size
_SIDE_PX = 616
_GAP_PX = 14
_TITLE_PX = 36
_MIN_LETTER_PX = 7  # height of letters of titles; narrow panels have smaller ones
_HEAD_PX = 46
_MIN_TABLE_PX = 130
_FARTHEST_M = 90.0  # no point of KITTI's LiDAR lies farther away
_WIDE = 2.0  # minimum width / height of pictures that are stacked
_HIGHEST = 1.5  # maximum height of a picture / width of its panel; higher ones become narrower
_MAX_OBJECTS = 500  # maximum number drawn; twenty times KITTI's fullest frame
_NO_POINT, _NO_VALUE = "no point", "no value"
_SPARSE_SHARE = 0.3  # maps with values on fewer pixels are drawn with larger points


@dataclass(frozen=True, kw_only=True)
class _Panel:
    title: str
    picture: UInt8[np.ndarray, "height width 3"]
    scale: ColorScale | None = None
    hole: str = ""
    """Caption of pixels without a value."""


@dataclass(frozen=True)
class _Frame:
    """Content of the page, at its drawn size."""

    sample: CameraLidarSample
    perception: Perception

    @property
    def has_detections(self) -> bool:
        """Test whether detections or joined objects are drawn; labels are then white."""
        found = self.perception
        return any(
            each is not None for each in (found.objects, found.detections2d, found.detections3d)
        )

    @property
    def has_boxes3d(self) -> bool:
        """Test whether 3D boxes of detections or joined objects are drawn."""
        return self.perception.objects is not None or self.perception.detections3d is not None


@named_arguments
def frame_sheet(
    sample: CameraLidarSample,
    dense_depth: DepthMap | None = None,
    *,
    dense_name: str = "",
    detections2d: Detections2D | None = None,
    detections3d: Detections3D | None = None,
    objects: Objects | None = None,
    further: Mapping[str, FurtherPrediction] | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw an RGB page of the frame's boxes, sweep and depth maps, with titles and legends.

    Shows the image with 2D boxes (their corners) and 3D boxes (their visible edges), the LiDAR
    coloured by range on it, the sparse depth, the dense depth with its expected error (if it has
    one) and its error (if the sample has true depth), further predictions, a bird's-eye view and a
    table of the objects. Missing parts are named in their places. If there are detections, they
    have the colours and labels are white. At most 500 labels are drawn, the nearest, and at most
    500 detections, those with the highest scores.

    Examples:
        >>> import sightline, tempfile
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> page = sightline.frame_sheet(sightline.open_dataset(PACKAGED_FRAMES)[0])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sightline.write_rgb(f"{folder}/000000.png", page)

    Args:
        sample: The sample; any of image, points, objects and depth may be None.
        dense_depth: A completed depth map of the sample's image size.
        dense_name: Name of the depth map's method or weights, for its title.
        detections2d: Detections drawn on the image.
        detections3d: Detections drawn on the image and from above, and listed.
        objects: Joined objects, drawn and listed instead of the detections.
        further: Predictions of other kinds, each with a panel of its own.

    Raises:
        ValueError: `dense_depth` is not of the sample's image size, or detections have another
            type.
    """
    for name, found, kind in (
        ("detections2d", detections2d, Detections2D),
        ("detections3d", detections3d, Detections3D),
        ("objects", objects, Objects),
    ):
        if not isinstance(found, kind | None):
            raise ValueError(
                f"{name} is a {type(found).__name__}, expected {kind.__name__}; of a "
                "prediction of detection2d, give its .detections, of joined its .objects"
            )
    if dense_depth is not None and tuple(dense_depth.depth_m.shape) != sample.image_size:
        raise ValueError(
            f"dense depth is {dense_depth.depth_m.shape[0]}x{dense_depth.depth_m.shape[1]} (height "
            f"x width), expected {sample.image_size[0]}x{sample.image_size[1]} like sample "
            f"{sample.sample_id}; complete the depth at the image's size"
        )
    num_columns = 1 if sample.image_size[1] >= _WIDE * sample.image_size[0] else 2
    panel_px = (_COLUMN_PX - (num_columns - 1) * _GAP_PX) // num_columns
    perception = Perception(
        objects=objects and objects.select(_highest_scores(objects.scores)),
        detections2d=detections2d and detections2d.select(_highest_scores(detections2d.scores)),
        detections3d=detections3d and detections3d.select(_highest_scores(detections3d.scores)),
        depth=dense_depth,
        further=further or {},
    )
    sample, perception = level_view(sample, perception)
    frame = _fitted(replace(sample, objects=_nearest(sample.objects)), perception, panel_px)
    panels = [_boxes_panel(frame), _lidar_panel(frame), *_depth_panels(frame, dense_name)]
    for each in frame.perception.further.values():
        picture = scaled_into(each.draw(frame.sample), panels[0].picture.shape[:2])
        panels.append(_Panel(title=each.title, picture=picture))
    main = _arranged([_titled(panel, panel_px) for panel in panels], num_columns)
    side = _side_column(frame, main.shape[0])
    body = np.concatenate((main, _blank(main.shape[0], _GAP_PX), side), axis=1)
    framed = cv2.copyMakeBorder(
        body, _HEAD_PX, _GAP_PX, _GAP_PX, _GAP_PX, cv2.BORDER_CONSTANT, value=PAGE
    )
    page = framed.astype(np.uint8, copy=False)
    _put_head(page, sample)
    return page


def _nearest(labels: ObjectLabels | None) -> ObjectLabels | None:
    """Select the nearest labels to draw; labels without a 3D part count as farthest."""
    if labels is None or len(labels) <= _MAX_OBJECTS:
        return labels
    ranges_m = labels.boxes3d.centers[:, :2].norm(dim=1)
    order = torch.where(labels.has_box3d, ranges_m, torch.inf).argsort(stable=True)
    is_drawn = torch.zeros(len(labels), dtype=torch.bool)
    is_drawn[order[:_MAX_OBJECTS]] = True
    return labels.select(is_drawn)


def _highest_scores(scores: Float[Tensor, " num_detections"]) -> Int64[Tensor, " num_kept"]:
    """Indices of the highest scores to draw, in the order of the detections."""
    return scores.argsort(descending=True, stable=True)[:_MAX_OBJECTS].sort().values


def _fitted(sample: CameraLidarSample, perception: Perception, panel_px: int) -> _Frame:
    """Scale the frame to the panel; a frame of nearly that size stays unchanged."""
    height, width = sample.image_size
    zoom = min(panel_px / width, _HIGHEST * panel_px / height)
    if 1 <= zoom <= 1 / 0.75:
        return _Frame(sample, perception)
    size = (max(round(height * zoom), 1), max(round(width * zoom), 1))
    return _Frame(*zoomed(sample, perception, size))


def _backdrop(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"]:
    if sample.image is None:
        return _notice(sample.image_size, "no camera image")
    return camera_picture(sample)


def _notice(size: tuple[int, int], text: str) -> UInt8[np.ndarray, "height width 3"]:
    picture = np.full((*size, 3), INVALID, np.uint8)
    left = (size[1] - text_width(text, 12)) // 2
    put_text(picture, text, left, size[0] // 2 + 6, height_px=12, color=MUTED)
    return picture


def _boxes_panel(frame: _Frame) -> _Panel:
    """Draw labels below detections, and 3D boxes below the corners of 2D boxes."""
    sample, picture = frame.sample, _backdrop(frame.sample)
    in_2d, in_3d = frame.perception.detections2d, frame.perception.detections3d
    labels = sample.objects
    if labels is not None:
        picture = _with_labels(picture, frame, beside_detections=frame.has_detections)
    beside = "" if labels is None else ", labels in white"
    if frame.perception.objects is not None:
        picture = draw_objects(picture, frame.perception.objects, sample)
        return _Panel(title=f"Objects: {OBJECTS_LEGEND}{beside}", picture=picture)
    picture = draw_detections(picture, in_2d, in_3d, sample.calibration)
    if frame.has_detections:
        kinds = [*["2D boxes"] * (in_2d is not None), *["3D boxes"] * (in_3d is not None)]
        if len(kinds) > 1:
            kinds = ["2D boxes (corners)", "3D boxes (edges)"]
        title = f"Detections: {', '.join(kinds)}{beside}"
    else:
        title = "2D and 3D boxes: labels" if labels is not None else "Image: no labels"
    return _Panel(title=title, picture=picture)


def _with_labels(
    picture: UInt8[np.ndarray, "height width 3"], frame: _Frame, *, beside_detections: bool
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw labels in the colours of classes; beside detections in white, of the same dimension."""
    labels = frame.sample.objects
    assert labels is not None, "there are labels to draw"
    color = _LABEL_BESIDE_DETECTION if beside_detections else None
    if not beside_detections or frame.has_boxes3d:
        kept = labels.select(labels.has_box3d)
        picture = draw_boxes3d(
            picture,
            kept.boxes3d,
            kept.class_names,
            frame.sample.calibration,
            color=color,
            tags=False,
        )
    if not beside_detections or not frame.has_boxes3d:
        picture = draw_boxes2d(
            picture,
            labels.boxes2d,
            labels.class_names,
            color=color,
            tags=not beside_detections,
            corners_only=not beside_detections,
        )
    return picture


def _lidar_panel(frame: _Frame) -> _Panel:
    sample = frame.sample
    title = "LiDAR by range on the image"
    if sample.points is None:
        return _Panel(title=title, picture=_notice(sample.image_size, "no LiDAR sweep"))
    dimmed = np.rint(_backdrop(sample) * 0.55).astype(np.uint8)
    picture = draw_points(dimmed, sample.points, sample.calibration)
    return _Panel(title=title, picture=picture, scale=DEPTH_SCALE)


def _depth_panels(frame: _Frame, dense_name: str) -> list[_Panel]:
    sample, dense, truth = frame.sample, frame.perception.depth, frame.sample.depth
    panels = []
    if sample.points is None:
        picture = _notice(sample.image_size, "no LiDAR sweep")
        panels.append(_Panel(title="Sparse depth", picture=picture))
    else:
        sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        share = f"{100 * float((sparse > 0).float().mean()):.1f} % of the pixels"
        picture = colorize_depth(sparse, point_size_px=3)
        title = f"Sparse depth: {share}"
        panels.append(_Panel(title=title, picture=picture, scale=DEPTH_SCALE, hole=_NO_POINT))
    if truth is not None and dense is None:
        picture = colorize_depth(truth, point_size_px=_point_size(truth))
        panels.append(
            _Panel(title="True depth", picture=picture, scale=DEPTH_SCALE, hole=_NO_VALUE)
        )
    if dense is not None:
        title = "Dense depth" + (f": {dense_name}" if dense_name else "")
        if dense.guessed is not None:
            title += "; darker: guessed from the image"
        picture = draw_depth(dense)
        panels.append(_Panel(title=title, picture=picture, scale=DEPTH_SCALE, hole=_NO_VALUE))
        if dense.uncertainty_m is not None:
            picture = colorize_depth(dense.uncertainty_m, scale=UNCERTAINTY_SCALE)
            title = "Error of the dense depth that the network expects, everywhere"
            panels.append(
                _Panel(title=title, picture=picture, scale=UNCERTAINTY_SCALE, hole=_NO_VALUE)
            )
        if truth is not None:
            picture = colorize_error(dense.shown_m, truth, point_size_px=_point_size(truth))
            title = "Dense depth less true depth; violet where none was predicted"
            panels.append(_Panel(title=title, picture=picture, scale=ERROR_SCALE))
    return panels


def _point_size(depth_m: Float32[Tensor, "height width"]) -> int:
    return 3 if float((depth_m > 0).float().mean()) < _SPARSE_SHARE else 1


def _side_column(frame: _Frame, height: int) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the bird's-eye view and, if there is room, the table of the objects."""
    sample, labels = frame.sample, frame.sample.objects
    objects, found = frame.perception.objects, frame.perception.detections3d
    listed = objects if objects is not None else found if found is not None else labels
    view = BirdsEyeView(pixels_per_m=_SIDE_PX / (BirdsEyeView.y_max_m - BirdsEyeView.y_min_m))
    room = height - _TITLE_PX
    left_over = room - view.picture_size[0] - _GAP_PX - _TITLE_PX
    if listed is None or left_over < _MIN_TABLE_PX:
        left_over = 0
        farthest_m = min(view.x_min_m + room / view.pixels_per_m, _FARTHEST_M)
        view = replace(view, x_max_m=farthest_m)
    picture = draw_birds_eye(
        sample.points,
        None if labels is None else labels.boxes3d,
        () if labels is None else labels.class_names,
        calibration=sample.calibration,
        image_size=sample.image_size,
        view=view,
        color=_LABEL_BESIDE_DETECTION if frame.has_detections else None,
    )
    if objects is not None:
        styles = box_styles(objects, sample)
        put_boxes_from_above(picture, view, objects.boxes3d, objects.class_names, styles=styles)
    elif found is not None:
        put_boxes_from_above(picture, view, found.boxes, found.class_names)
    column = [_titled(_Panel(title="Bird's-eye view", picture=picture), _SIDE_PX)]
    if listed is not None and left_over > 0:
        table = draw_object_table(listed, sample.points, width_px=_SIDE_PX, max_height_px=left_over)
        title = "Detected objects" if frame.has_boxes3d else "Labelled objects"
        column += [_blank(_GAP_PX, _SIDE_PX), _titled(_Panel(title=title, picture=table), _SIDE_PX)]
    filled = sum(part.shape[0] for part in column)
    return np.concatenate((*column, _blank(height - filled, _SIDE_PX)))


def _titled(panel: _Panel, width_px: int) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the picture below its title and legend, padded to the panel's width."""
    line = _blank(_TITLE_PX, width_px)
    height_px = max(_MIN_LETTER_PX, min(11, 11 * width_px // max(text_width(panel.title, 11), 1)))
    put_text(line, panel.title, 0, _TITLE_PX - 12, height_px=height_px, color=TITLE)
    if panel.scale is not None and text_width(panel.title, 11) + 430 < width_px:
        put_legend(line, panel.scale, right=width_px - 24, top=8, hole=panel.hole)
    height, width = panel.picture.shape[:2]
    padded = np.concatenate((panel.picture, _blank(height, width_px - width)), axis=1)
    return np.concatenate((line, padded))


def _arranged(
    pictures: Sequence[UInt8[np.ndarray, "_height _width 3"]], num_columns: int
) -> UInt8[np.ndarray, "height width 3"]:
    """Arrange pictures of one size in rows of `num_columns`."""
    height, width = pictures[0].shape[:2]
    blanks = [_blank(height, width)] * (-len(pictures) % num_columns)
    cells = [*pictures, *blanks]
    rows = []
    for start in range(0, len(cells), num_columns):
        row = [cells[start]]
        for cell in cells[start + 1 : start + num_columns]:
            row += [_blank(height, _GAP_PX), cell]
        joined = np.concatenate(row, axis=1)
        rows += [_blank(_GAP_PX, joined.shape[1])] * (start > 0) + [joined]
    return np.concatenate(rows)


def _blank(height: int, width: int) -> UInt8[np.ndarray, "height width 3"]:
    return np.full((height, width, 3), PAGE, np.uint8)


def _put_head(page: UInt8[np.ndarray, "height width 3"], sample: CameraLidarSample) -> None:
    height, width = sample.image_size
    facts = [f"{width} x {height} px"]
    if sample.points is not None:
        facts.append(f"{len(sample.points):,} LiDAR points")
    if sample.objects is not None:
        number = int(sample.objects.has_box3d.sum())
        facts.append("1 object" if number == 1 else f"{number:,} objects")
        if len(sample.objects) > _MAX_OBJECTS:
            facts.append(f"the nearest {_MAX_OBJECTS} are drawn")
    put_text(page, sample.sample_id, _GAP_PX, 32, height_px=15, color=TITLE)
    left = _GAP_PX + text_width(sample.sample_id, 15) + 18
    put_text(page, "   ".join(facts), left, 32, height_px=11, color=MUTED)
