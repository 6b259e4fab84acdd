"""What `import sightline` gives, and that the examples in its docstrings do what they say."""

import doctest
import inspect
import subprocess
import sys
from importlib.metadata import version

import pytest

import sightline

NAMES = tuple(name for name in sightline.__all__ if name != "__version__")


def test_importing_the_package_imports_nothing_else_of_weight():
    code = (
        "import sys; before = set(sys.modules); import sightline; "
        "sightline.__version__; heavy = {'torch', 'numpy', 'cv2', 'beartype', 'jsonargparse'}; "
        "print(sorted(heavy & (set(sys.modules) - before)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_predictors_import_nothing_of_training_and_no_progress_bars():
    code = (
        "import sys, sightline.detection2d.predictor, sightline.detection3d.predictor, "
        "sightline.depth_completion.predictor; "
        "needless = {'lightning', 'torchmetrics', 'sightline.training', 'rich'}; "
        "print(sorted(needless & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_first_prediction_imports_no_training_and_no_compiler():
    code = (
        "import sys; import sightline; import sightline.perception.perceive; "
        "from sightline.simulation.packaged import PACKAGED_FRAMES; "
        "sample = sightline.open_dataset(PACKAGED_FRAMES)[0]; "
        "sightline.load('detection2d-fast-cpu', engine='torch')(sample); "
        "sightline.load('detection3d-fast-cpu', engine='torch')(sample); "
        "needless = {'lightning', 'torchmetrics', 'tensorboard', 'torchvision', 'embreex', "
        "'matplotlib', 'pandas', 'onnx', 'torch._dynamo', 'torch._inductor', 'sympy', "
        "'sightline.training'}; print(sorted(needless & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_every_name_is_where_the_type_checker_is_told_it_is():
    source = inspect.getsource(sightline)
    for name in NAMES:
        value = getattr(sightline, name)
        assert f"from {value.__module__} import {name} as {name}" in source
    assert set(sightline.__all__) <= set(dir(sightline))


def test_the_version_is_that_of_the_distribution():
    assert sightline.__version__ == version("sightline")


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'detect_everything'"):
        _ = sightline.detect_everything


def test_an_earlier_name_works_and_says_what_it_is_called_now():
    with pytest.warns(DeprecationWarning, match="Perceiver is now sightline.MultiTaskPredictor"):
        assert sightline.Perceiver is sightline.MultiTaskPredictor


@pytest.mark.parametrize("name", NAMES)
def test_the_examples_of_a_name_run_as_they_are_copied_and_give_what_they_say(name):
    value = getattr(sightline, name)
    module = sys.modules[value.__module__]
    found = doctest.DocTestFinder().find(value, name, module, globs={})  # no name of the module
    tests = [test for test in found if test.examples]
    assert name in {test.name for test in tests}, f"{name} has no example in its docstring"
    complaints = []
    for test in tests:
        doctest.DocTestRunner(verbose=False).run(test, out=complaints.append)
    assert "".join(complaints) == ""
