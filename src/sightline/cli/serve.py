"""`sightline serve`: a page on which sensors are broken and predictions watched."""

import shlex
from pathlib import Path

from sightline.cli.output import say
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.export.names import EngineChoice
from sightline.files.extras import require_library
from sightline.files.problem import refuse_without_effect
from sightline.training.interruption import Interruption

_PORT = 8000


def serve(
    data_set: Path | None = None,
    *,
    host: str | None = None,
    port: int = _PORT,
    browser: bool = True,
    workers: int = 2,
    velodyne: Velodyne | None = None,
    engine: EngineChoice = "auto",
    export: Path | None = None,
    frames: tuple[str, ...] | None = None,
    kinds: tuple[str, ...] | None = None,
    severities: tuple[int, ...] | None = None,
) -> None:
    """Open a page in the browser: break a sensor, and see what is still detected.

    Shows image, points, depth, health and objects, clean beside broken. Nothing is written, and
    only this machine can open the page unless --host is given; Ctrl-C ends it. With --export the
    page is instead written to a folder of plain files, with results computed beforehand, which any
    web server can show; an interrupted export goes on when it is run again.

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
        export: Folder for the exported page, not within the data; an older export is replaced.
        frames: Frames to export. Default: the first two.
        kinds: Kinds of fault to export beside those of the page's buttons, such as lidar_rain.
        severities: Severities of these kinds, from 1 to 5. Default: all.
    """
    for library in ("starlette", "uvicorn"):
        require_library(library, "app")
    if export is not None:
        refuse_without_effect(
            "with --export, which opens no page", host=host is not None, port=port != _PORT
        )
        from sightline.app.site import export_page

        content = export_page(
            data_set,
            export,
            frames=frames,
            kinds=kinds or (),
            severities=severities,
            workers=workers,
            velodyne=velodyne,
            engine=engine,
            announce=say,
        )
        place = shlex.quote(str(export))
        say(f"{export}: {content}; to look at it: python -m http.server --directory {place}")
        return
    for name, given in {"frames": frames, "kinds": kinds, "severities": severities}.items():
        if given:
            raise ValueError(f"--{name} is for --export; give --export FOLDER, or leave it out")
    from sightline.app.run import serve_page

    try:
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
    except Interruption as error:
        raise Interruption("the page has ended", error.number) from None
