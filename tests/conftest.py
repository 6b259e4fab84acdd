"""What all tests share."""

import gc
import os
import signal
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import settings

from tests import shape_checks

# Read when PyTorch is first imported: on small tensors, and beside other test processes, its
# threads only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Networks run by PyTorch where no engine is named: to convert them for another takes ten seconds
# each. What another gives is tested in tests/export, and each task's own test_export.
os.environ["SIGHTLINE_ENGINE"] = "torch"

shape_checks.install()

# A shell that starts the tests in the background has them ignore Ctrl-C, which some of them send.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No deadline: compiling a kernel and the first call of a library take long and prove nothing.
# The check takes the same examples each time; elsewhere new ones are drawn.
settings.register_profile(
    "sightline", deadline=None, print_blob=True, derandomize=bool(os.environ.get("CI"))
)
settings.load_profile("sightline")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leaves imports out of the search for garbage, which takes half a second each time."""
    gc.disable()
    found = yield
    gc.freeze()
    gc.enable()
    return found


def pytest_unconfigure() -> None:
    """Lets Python free what libraries expect to be freed at its end."""
    gc.unfreeze()


def pytest_runtest_setup() -> None:
    """Starts the shape checks of each test anew."""
    shape_checks.begin_test()


@pytest.fixture(scope="session", autouse=True)
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Converted networks are kept for all processes of a run, where an earlier run left nothing."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    os.environ["XDG_CACHE_HOME"] = str(shared / "cache")


@pytest.fixture(scope="session")
def kitti_root() -> Path:
    """The folder of real KITTI frames; tests that need it are skipped where there is none."""
    folder = os.environ.get("SIGHTLINE_KITTI")
    if not folder:
        pytest.skip("SIGHTLINE_KITTI is unset: set it to a folder of real KITTI frames")
    root = Path(folder).resolve()
    if not (root / "training").is_dir():
        pytest.fail(f"SIGHTLINE_KITTI is {folder}, which holds no folder training/")
    return root
