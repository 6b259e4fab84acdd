"""Recordings, bags and a nuScenes folder of one simulated frame, for the tests of their readers."""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import yaml
from pypcd4 import PointCloud
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.image_file import write_rgb
from sightline.simulation.packaged import PACKAGED_FRAMES

SAMPLE = KittiObjectDataset(PACKAGED_FRAMES)[0]
LABELS = PACKAGED_FRAMES / "training" / "label_2" / "000000.txt"
IMAGE = np.ascontiguousarray(SAMPLE.image.permute(1, 2, 0).numpy())
POINTS = SAMPLE.points.numpy()
CAMERA_MATRIX = SAMPLE.calibration.image_from_camera[:, :3].numpy()
CAMERA_FROM_LIDAR = SAMPLE.calibration.camera_from_lidar.numpy().copy()
# The camera's own centre is the origin here, not that of KITTI's camera 0.
CAMERA_FROM_LIDAR[:3, 3] += np.linalg.solve(
    CAMERA_MATRIX, SAMPLE.calibration.image_from_camera[:, 3].numpy()
)


def write_cloud_file(path: Path, points: np.ndarray = POINTS) -> None:
    """A cloud in the format that its name ends in; intensities of 0 to 255."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scaled = points * np.float32([1, 1, 1, 255])
    if path.suffix == ".pcd":
        PointCloud.from_xyzi_points(scaled).save(path)
    elif path.suffix == ".ply":
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(scaled)}\n"
        header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
        path.write_bytes(header.encode() + b"end_header\n" + scaled.tobytes())
    elif path.suffix == ".npy":
        np.save(path, scaled.astype(np.float64))
    else:
        scaled.tofile(path)


def calibration_entries(**changes: object) -> dict[str, object]:
    """What a calibration file says."""
    return {
        "camera_matrix": CAMERA_MATRIX.tolist(),
        "camera_from_lidar": CAMERA_FROM_LIDAR.tolist(),
        "max_intensity": 255,
        **changes,
    }


def write_calibration(folder: Path, **changes: object) -> None:
    """The calibration file of a recording, in place of any that is there."""
    text = yaml.safe_dump(calibration_entries(**changes))
    (folder / "calibration.yaml").write_text(text)


def write_recording(
    folder: Path,
    names: tuple[str, ...] = ("a", "b"),
    *,
    cloud: str = ".pcd",
    picture: str = ".jpg",
    **changes: object,
) -> Path:
    """A recording of one frame again and again, in which no two files are quite the same."""
    for place, name in enumerate(names):
        image = IMAGE.copy()
        image[:8, : 8 * place] = 0
        write_rgb(folder / "images" / f"{name}{picture}", image)
        write_cloud_file(folder / "points" / f"{name}{cloud}", POINTS[: len(POINTS) - place])
    write_calibration(folder, **changes)
    return folder


class BagMaker:
    """Writes a ROS 2 bag of a camera and a LiDAR that see the simulated frame."""

    def __init__(self, path: Path, *, storage: StoragePlugin = StoragePlugin.MCAP) -> None:
        self.types = get_typestore(Stores.ROS2_HUMBLE)
        self._writer = Writer(path, version=9, storage_plugin=storage)
        self._connections: dict[str, object] = {}

    def __enter__(self):
        self._writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.close()

    def write(self, topic: str, message: object, time_ns: int) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=self.types
            )
        raw = self.types.serialize_cdr(message, message.__msgtype__)
        self._writer.write(self._connections[topic], time_ns, raw)

    def new(self, kind: str, **fields: object) -> object:
        return self.types.types[kind](**fields)

    def header(self, frame: str, time_ns: int) -> object:
        stamp = self.new(
            "builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9
        )
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _number(self, topic: str) -> int:
        """Number of messages before, from 0."""
        counts: Counter[str] = self.__dict__.setdefault("_counts", Counter())
        counts[topic] += 1
        return (counts[topic] - 1) % 256

    def image(self, topic: str, time_ns: int, *, picture: np.ndarray = IMAGE, shift_ns: int = 0):
        if picture is IMAGE:  # a camera's pictures differ
            picture = IMAGE.copy()
            picture[0, 0] += np.uint8(self._number(topic))
        message = self.new(
            "sensor_msgs/msg/Image",
            header=self.header("camera_optical", time_ns),
            height=picture.shape[0],
            width=picture.shape[1],
            encoding="bgr8",
            is_bigendian=0,
            step=picture.shape[1] * 3,
            data=np.ascontiguousarray(picture[..., ::-1]).ravel(),
        )
        self.write(topic, message, time_ns + shift_ns)

    def jpeg(self, topic: str, time_ns: int, content: bytes) -> None:
        message = self.new(
            "sensor_msgs/msg/CompressedImage",
            header=self.header("camera_optical", time_ns),
            format="bgr8; jpeg compressed bgr8",
            data=np.frombuffer(content, np.uint8),
        )
        self.write(topic, message, time_ns)

    def cloud(
        self,
        topic: str,
        time_ns: int,
        *,
        names=("x", "y", "z", "intensity"),
        points=None,
        frame="lidar",
    ) -> None:
        rows = POINTS * np.float32([1, 1, 1, 255]) if points is None else points
        if points is None:  # a LiDAR's clouds differ
            rows[-1, 3] = (rows[-1, 3] + self._number(topic)) % 256
        fields = [
            self.new("sensor_msgs/msg/PointField", name=name, offset=4 * at, datatype=7, count=1)
            for at, name in enumerate(names)
        ]
        padded = np.zeros((len(rows), 5), np.float32)  # drivers leave gaps between points
        padded[:, :4] = rows
        message = self.new(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(frame, time_ns),
            height=1,
            width=len(rows),
            fields=fields,
            is_bigendian=False,
            point_step=20,
            row_step=20 * len(rows),
            data=padded.view(np.uint8).ravel(),
            is_dense=False,
        )
        self.write(topic, message, time_ns)

    def info(
        self,
        topic: str,
        time_ns: int,
        *,
        distortion=(0.0,) * 5,
        model="plumb_bob",
        size=IMAGE.shape[:2],
        rectification=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        matrix=CAMERA_MATRIX,
        binning=(0, 0),
        region=(0, 0, 0, 0),
        offset_px=0.0,
        projection=None,
    ):
        """region: x, y, height, width; projection: P without its last column, None: the matrix."""
        roi = self.new(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=region[0],
            y_offset=region[1],
            height=region[2],
            width=region[3],
            do_rectify=False,
        )
        projection = np.pad(matrix if projection is None else projection, ((0, 0), (0, 1)))
        projection = projection.astype(np.float64)
        projection[0, 3] = offset_px
        message = self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header("camera_optical", time_ns),
            height=size[0],
            width=size[1],
            distortion_model=model,
            d=np.array(distortion),
            k=np.ravel(matrix),
            r=np.ravel(rectification),
            p=projection.ravel(),
            binning_x=binning[0],
            binning_y=binning[1],
            roi=roi,
        )
        self.write(topic, message, time_ns)

    def transforms(
        self, topic: str, time_ns: int, *, length: float = 1.0, **parent_from_child: np.ndarray
    ) -> None:
        """Transforms by "parent__child", with quaternions of a length."""
        each = []
        for pair, rigid in parent_from_child.items():
            parent, child = pair.split("__")
            x, y, z, w = Rotation.from_matrix(rigid[:3, :3]).as_quat() * length
            move = self.new(
                "geometry_msgs/msg/Vector3", x=rigid[0, 3], y=rigid[1, 3], z=rigid[2, 3]
            )
            turn = self.new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
            each.append(
                self.new(
                    "geometry_msgs/msg/TransformStamped",
                    header=self.header(parent, time_ns),
                    child_frame_id=child,
                    transform=self.new(
                        "geometry_msgs/msg/Transform", translation=move, rotation=turn
                    ),
                )
            )
        self.write(topic, self.new("tf2_msgs/msg/TFMessage", transforms=each), time_ns)


class Ros1BagMaker(BagMaker):
    """Writes the same into a bag of ROS 1."""

    def __init__(self, path: Path, *, compression: Ros1Writer.CompressionFormat | None = None):
        self.types = get_typestore(Stores.ROS1_NOETIC)
        self.types.register(
            get_types_from_msg(
                "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
            )
        )
        self._writer = Ros1Writer(path)
        if compression is not None:
            self._writer.set_compression(compression)
        self._connections: dict[str, object] = {}

    def connect(self, topic: str, kind: str, *, callerid: str) -> None:
        """Write the topic's further messages as a node's."""
        self._connections[topic] = self._writer.add_connection(
            topic, kind, typestore=self.types, callerid=callerid
        )

    def write(self, topic: str, message: object, time_ns: int) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=self.types
            )
        raw = self.types.serialize_ros1(message, message.__msgtype__)
        self._writer.write(self._connections[topic], time_ns, raw)

    def new(self, kind: str, **fields: object) -> object:
        if kind == "sensor_msgs/msg/CameraInfo":  # ROS 1 writes K, not k
            fields = {name.upper() if len(name) == 1 else name: fields[name] for name in fields}
        return self.types.types[kind](**fields)

    def header(self, frame: str, time_ns: int) -> object:
        stamp = self.new(
            "builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9
        )
        return self.new("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=f"/{frame}")


BASE_FROM_LIDAR = np.eye(4)
BASE_FROM_LIDAR[:3, 3] = (0.2, 0.0, 1.8)
CAMERA_FROM_BASE = CAMERA_FROM_LIDAR @ np.linalg.inv(BASE_FROM_LIDAR)


def write_bag(
    path: Path, num_frames: int = 3, *, storage: StoragePlugin = StoragePlugin.MCAP, **info: object
) -> Path:
    """A whole bag: images at 10 Hz, sweeps 8 ms later, one image more than sweeps."""
    with BagMaker(path, storage=storage) as bag:
        bag.transforms(
            "/tf_static", 10**9, base__lidar=BASE_FROM_LIDAR, camera_optical__base=CAMERA_FROM_BASE
        )
        for number in range(num_frames + 1):
            time_ns = 2 * 10**9 + number * 10**8
            bag.info("/front/camera_info", time_ns, **info)
            bag.image("/front/image_raw", time_ns)
            if number < num_frames:
                bag.cloud("/points", time_ns + 8 * 10**6)
    return path


def write_nuscenes(root: Path, *, num_samples: int = 2) -> Path:
    """nuScenes' tables and files of one scene whose car drives along, with its labels.

    The LiDAR has x to the right and y ahead, as nuScenes' has.
    """
    lidar_from_ours = np.eye(4)
    lidar_from_ours[:3, :3] = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    ego_from_lidar = np.eye(4)
    ego_from_lidar[:3, 3] = (0.9, 0.0, 1.84)
    ego_from_lidar[:3, :3] = lidar_from_ours[:3, :3].T
    camera_from_lidar = CAMERA_FROM_LIDAR @ np.linalg.inv(lidar_from_ours)
    ego_from_camera = ego_from_lidar @ np.linalg.inv(camera_from_lidar)
    tables: dict[str, list[dict[str, object]]] = {
        name: []
        for name in [
            "sample",
            "sample_data",
            "ego_pose",
            "sample_annotation",
            "instance",
            "category",
        ]
    }
    tables["scene"] = [{"token": "s0", "name": "scene-0001"}]
    tables["attribute"] = [{"token": "ridden", "name": "cycle.with_rider"}]
    tables["sensor"] = [
        {"token": "c", "channel": "CAM_FRONT", "modality": "camera"},
        {"token": "l", "channel": "LIDAR_TOP", "modality": "lidar"},
    ]
    tables["calibrated_sensor"] = [
        {"token": "cc", "sensor_token": "c", **pose_entries(ego_from_camera)}
        | {"camera_intrinsic": CAMERA_MATRIX.tolist()},
        {"token": "cl", "sensor_token": "l", **pose_entries(ego_from_lidar)}
        | {"camera_intrinsic": []},
    ]
    names = {
        "Car": "vehicle.car",
        "Pedestrian": "human.pedestrian.adult",
        "Cyclist": "vehicle.bicycle",
    }
    tables["category"] = [{"token": name, "name": name} for name in names.values()]
    tables["instance"] = [{"token": f"i-{name}", "category_token": name} for name in names.values()]
    sweep = np.zeros((len(POINTS), 5), np.float32)
    sweep[:, :3] = POINTS[:, :3] @ lidar_from_ours[:3, :3].T
    sweep[:, 3] = POINTS[:, 3] * 255
    for number in range(num_samples):
        world_from_ego = np.eye(4)
        world_from_ego[:3, :3] = Rotation.from_euler("z", 0.4 * number).as_matrix()
        world_from_ego[:3, 3] = (600.0 + number, 1600.0, 0.0)
        token = f"s0-{number}"
        time_us = 1_500_000_000_000_000 + number * 500_000
        tables["sample"].append({"token": token, "scene_token": "s0", "timestamp": time_us})
        tables["ego_pose"].append({"token": token, **pose_entries(world_from_ego)})
        common = {"sample_token": token, "ego_pose_token": token, "is_key_frame": True}
        image, cloud = f"samples/CAM_FRONT/{number}.jpg", f"samples/LIDAR_TOP/{number}.pcd.bin"
        height, width = IMAGE.shape[:2]
        tables["sample_data"] += [
            {"token": f"{token}-c", "calibrated_sensor_token": "cc", "filename": image}
            | {"timestamp": time_us, "height": height, "width": width, **common},
            {"token": f"{token}-l", "calibrated_sensor_token": "cl", "filename": cloud}
            | {"timestamp": time_us, "height": 0, "width": 0, **common},
        ]
        picture = IMAGE.copy()
        picture[:8, : 8 * number] = 0
        write_rgb(root / image, picture)
        (root / cloud).parent.mkdir(parents=True, exist_ok=True)
        sweep[:, 4] = number
        sweep.tofile(root / cloud)
        world_from_ours = world_from_ego @ ego_from_lidar @ lidar_from_ours
        labels = SAMPLE.objects
        for index, name in enumerate(labels.class_names):
            box = labels.boxes3d[index : index + 1]
            if name not in names or not bool(labels.has_box3d[index]):
                continue
            ours_from_box = np.eye(4)
            ours_from_box[:3, :3] = Rotation.from_euler("z", float(box.yaws[0])).as_matrix()
            ours_from_box[:3, 3] = box.centers[0].numpy()
            length, breadth, tall = box.sizes[0].tolist()
            hits = int(box.contain(SAMPLE.points[:, :3].to(torch.float64)).sum())
            tables["sample_annotation"].append(
                {
                    "token": f"{token}-{index}",
                    "sample_token": token,
                    "instance_token": f"i-{names[name]}",
                    "attribute_tokens": ["ridden"] if name == "Cyclist" else [],
                    "visibility_token": "4",
                    "num_lidar_pts": hits,
                    "size": [breadth, length, tall],
                    **pose_entries(world_from_ours @ ours_from_box),
                }
            )
    folder = root / "v1.0-mini"
    folder.mkdir(parents=True)
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows))
    return root


def pose_entries(rigid: np.ndarray) -> dict[str, object]:
    """A pose as nuScenes' tables have it: the quaternion's w first."""
    x, y, z, w = Rotation.from_matrix(rigid[:3, :3]).as_quat().tolist()
    return {"rotation": [w, x, y, z], "translation": rigid[:3, 3].tolist()}


def usual_topics(bag, *, infos=True, number=2, **info):
    """The topics of a whole drive; CameraInfo with changes."""
    bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
    for at in range(number):
        time_ns = 2 * 10**9 + at * 10**8
        if infos:
            bag.info("/front/camera_info", time_ns, **info)
        bag.image("/front/image_raw", time_ns)
        bag.cloud("/points", time_ns)


def edit_table(root: Path, table: str, change: Callable[[list[dict[str, object]]], object]) -> None:
    """Change the rows of a table of `write_nuscenes`."""
    path = root / "v1.0-mini" / f"{table}.json"
    rows = json.loads(path.read_text())
    change(rows)
    path.write_text(json.dumps(rows))
