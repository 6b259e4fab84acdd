"""`sightline serve`: a page on which sensors are broken and predictions watched."""

from pathlib import Path

from sightline.cli.output import say
from sightline.data.kitti_trees import Velodyne
from sightline.export.names import EngineChoice
from sightline.files.extras import require_library


def serve(
    data_set: Path | None = None,
    *,
    host: str | None = None,
    port: int = 8000,
    browser: bool = True,
    workers: int = 2,
    velodyne: Velodyne | None = None,
    engine: EngineChoice = "auto",
) -> None:
    """Opens a page in the browser: break a sensor, and see what is still detected.

    Shows image, points, depth, health and objects, clean beside broken. Nothing is written, and
    only this machine can open the page unless --host is given; Ctrl-C ends it.

    Args:
        data_set: A recording, KITTI object tree, depth completion tree or raw drive. Default: the
            frames of the package.
        host: Address to listen on for other machines, such as 0.0.0.0; they need the token in
            the address that is printed.
        port: Port; 0 takes any free one.
        browser: Opens the browser.
        workers: Number of worker processes with one thread each.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        engine: Engine of the networks: by default (auto) openvino if it is installed, else torch.
    """
    for library in ("starlette", "uvicorn"):
        require_library(library, "app")
    from sightline.app.run import serve_page

    serve_page(
        data_set,
        host=host,
        port=port,
        browser=browser,
        workers=workers,
        velodyne=velodyne,
        engine=engine,
        announce=lambda address: say(f"{address} (Ctrl-C ends it)"),
    )
