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
from sightline.cli.interrupts import keep_interrupts
keep_interrupts(sys.argv[1:])
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


@pytest.mark.parametrize("hook", ["before", "after_in_parent"])
def test_ctrl_c_in_a_hook_of_fork_ends_the_program_a_moment_later(hook):
    script = f"""
import os, signal, subprocess, sys, time
from sightline.cli.interrupts import keep_interrupts
keep_interrupts(["predict"])
os.register_at_fork({hook}=lambda: signal.raise_signal(signal.SIGINT))
try:
    if os.fork() == 0:
        os._exit(0)
    time.sleep(60)
    print("not interrupted")
except KeyboardInterrupt:
    print("interrupted")
"""
    done = run(script)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


def test_what_else_python_drops_is_reported_as_before():
    script = """
from sightline.cli.interrupts import keep_interrupts
keep_interrupts([])
class Broken:
    def __del__(self):
        raise ZeroDivisionError("by chance")
Broken()
"""
    assert "by chance" in run(script).stderr
