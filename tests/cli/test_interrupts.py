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
keep_interrupts()
try:
    import imported
    time.sleep(60)
except KeyboardInterrupt as error:
    print("interrupted", getattr(error, "exit_status", 130))
"""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def run(script, *starter):
    program = [*starter, sys.executable, "-c", script]
    return subprocess.run(program, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_during_an_import_comes_when_the_import_is_done(tmp_path, number):
    (tmp_path / "imported.py").write_text(_IMPORTED % number)
    script = f"import sys; sys.path.append({str(tmp_path)!r}){_PROGRAM}"
    assert run(script).stdout.split() == ["imported", "interrupted", str(128 + number)]


def test_a_server_that_takes_over_gets_the_signal_that_an_import_delays(tmp_path):
    (tmp_path / "imported.py").write_text(_IMPORTED % signal.SIGTERM)
    taking_over = "import imported, signal; signal.signal(15, lambda *_: sys.exit('by the server'))"
    script = f"import sys; sys.path.append({str(tmp_path)!r}){_PROGRAM}"
    done = run(script.replace("import imported", taking_over))
    assert (done.stdout, done.stderr) == ("imported\n", "by the server\n")


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_elsewhere_comes_at_once(number):
    script = _PROGRAM.replace("import imported", f"import signal; signal.raise_signal({number})")
    assert run(script).stdout.split() == ["interrupted", str(128 + number)]


def test_an_import_without_end_is_left_with_the_line_and_the_status(tmp_path):
    (tmp_path / "imported.py").write_text(_IMPORTED % signal.SIGTERM + "while True: pass")
    script = f"""
import sys; sys.path.append({str(tmp_path)!r})
from sightline.cli import interrupts
interrupts._LONGEST_IMPORT_S = 0.2
{_PROGRAM}"""
    done = run(script)
    assert done.returncode == 128 + signal.SIGTERM
    assert done.stderr.startswith("sightline: interrupted; ")


def test_sighup_stays_ignored_under_nohup():
    script = _PROGRAM.replace("import imported", "import signal; signal.raise_signal(1)")
    assert run(script.replace("time.sleep(60)", "print('goes on')"), "nohup").stdout == (
        "goes on\n"
    )


def test_an_error_that_a_library_makes_of_the_exception_is_reported_as_the_interruption():
    script = """
import signal, sys
from sightline import __main__
from sightline.cli import main

def load():
    try:
        signal.raise_signal(signal.SIGTERM)
    except KeyboardInterrupt:
        raise ValueError("the file is damaged") from None

main._commands = lambda: {"load": load}
sys.argv = ["sightline", "load"]
sys.exit(__main__.run())
"""
    done = run(script)
    assert done.returncode == 128 + signal.SIGTERM
    assert done.stderr.startswith("sightline: interrupted; ")
    assert "damaged" not in done.stderr


@pytest.mark.parametrize("hook", ["before", "after_in_parent"])
def test_ctrl_c_in_a_hook_of_fork_ends_the_program_a_moment_later(hook):
    script = f"""
import os, signal, subprocess, sys, time
from sightline.cli.interrupts import keep_interrupts
keep_interrupts()
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
keep_interrupts()
class Broken:
    def __del__(self):
        raise ZeroDivisionError("by chance")
Broken()
"""
    assert "by chance" in run(script).stderr


def test_ctrl_c_that_is_dropped_as_python_ends_does_not_kill_it():
    script = """
import atexit
from sightline.cli.interrupts import keep_interrupts
class Dropped:
    def __del__(self):
        raise KeyboardInterrupt
keep_interrupts()
atexit.register(lambda: Dropped() and None)
many = [[] for _ in range(3_000_000)]  # freed in more time than the alarm needs
"""
    done = run(script)
    assert (done.returncode, done.stderr) == (0, "")
