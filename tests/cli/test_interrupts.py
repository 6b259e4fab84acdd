import subprocess
import sys

_IMPORTED = """
import os, signal
os.kill(os.getpid(), signal.SIGINT)
print("imported")
"""
_PROGRAM = """
import sys, time
from sightline.cli.interrupts import postpone_interrupts_while_importing
postpone_interrupts_while_importing()
try:
    import imported
    time.sleep(60)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_ctrl_c_during_an_import_comes_when_the_import_is_done(tmp_path):
    (tmp_path / "imported.py").write_text(_IMPORTED)
    script = f"import sys; sys.path.append({str(tmp_path)!r}){_PROGRAM}"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["imported", "interrupted"]


def test_ctrl_c_elsewhere_comes_at_once():
    script = _PROGRAM.replace("import imported", "import os, signal; signal.raise_signal(2)")
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["interrupted"]
