import signal
import subprocess
import sys

import pytest

_IMPORTED = """
import os
os.kill(os.getpid(), %d)
print("imported")
"""
_PROGRAM = """
import sys, time
from sightline.cli.interrupts import postpone_interrupts_while_importing
postpone_interrupts_while_importing(sys.argv[1:])
try:
    import imported
    time.sleep(60)
except KeyboardInterrupt as error:
    print("interrupted", getattr(error, "exit_status", 130))
"""
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run(script, *arguments):
    program = [sys.executable, "-c", script, *arguments]
    return subprocess.run(program, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_to_a_training_during_an_import_comes_when_the_import_is_done(tmp_path, number):
    (tmp_path / "imported.py").write_text(_IMPORTED % number)
    script = f"import sys; sys.path.append({str(tmp_path)!r}){_PROGRAM}"
    assert run(script, "fit").stdout.split() == ["imported", "interrupted", str(128 + number)]


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_to_a_training_elsewhere_comes_at_once(number):
    script = _PROGRAM.replace("import imported", f"import signal; signal.raise_signal({number})")
    assert run(script, "fit").stdout.split() == ["interrupted", str(128 + number)]


def test_sigterm_to_another_command_is_left_to_the_system():
    script = _PROGRAM.replace("import imported", "import signal; signal.raise_signal(15)")
    done = run(script, "predict")
    assert (done.returncode, done.stdout) == (-signal.SIGTERM, "")
