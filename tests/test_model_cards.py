"""docs/models.md has a card for each weights file, and it is of that file."""

import hashlib
import json
import math
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RESULTS = (ROOT / "docs" / "results.md", *(ROOT / "docs" / "results").glob("*.md"))
FILES = sorted((ROOT / "src" / "sightline" / "weights").glob("*.safetensors"))
TEXT = (ROOT / "docs" / "models.md").read_text()
CARDS = dict(re.findall(r"^## (.+)\n((?:(?!## ).*\n)*)", TEXT, re.MULTILINE))
ROWS = (
    "file", "numbers in it", "SHA-256", "input", "output", "data", "steps", "seed; commits", "time",
    "limits",
)  # fmt: skip


def rows_of(card):
    return dict(re.findall(r"^\| ([^|]+?) \| (.+) \|$", card, re.MULTILINE))


def header_of(content):
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length])


def test_each_weights_file_has_a_card_and_each_card_a_file():
    assert [file.stem for file in FILES] == sorted(CARDS)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_card_is_of_its_file(file):
    content = file.read_bytes()
    tensors = header_of(content)
    description = json.loads(tensors.pop("__metadata__")["sightline"])
    rows = rows_of(CARDS[file.stem])
    assert set(ROWS) <= set(rows)
    assert rows["file"].startswith(f"`{file.name}`, {len(content):,} bytes")
    count = sum(math.prod(tensor["shape"]) for tensor in tensors.values())
    assert rows["numbers in it"].startswith(f"{count:,}, of which ")
    assert rows["SHA-256"] == f"`{hashlib.sha256(content).hexdigest()}`"
    assert rows["seed; commits"].startswith(f"{description['provenance']['seed']};")
    steps = description["provenance"]["steps"]  # of the last training, or in words
    assert any(
        each in rows["steps"] for each in (steps, f"{int(steps):,}" if steps.isdigit() else steps)
    )
    recipe = rows.get("recipe") or rows["recipes"]
    for name in re.findall(r"`([\w-]+)`", recipe):
        assert (ROOT / "src" / "sightline" / "recipes" / f"{name}.yaml").is_file()


@pytest.mark.parametrize("name", CARDS)
def test_the_scores_of_a_card_stand_in_the_results(name):
    results = "".join(page.read_text() for page in RESULTS).replace("**", "")
    scores = [text for row, text in rows_of(CARDS[name]).items() if row.startswith("scores")]
    assert len(scores) == 2
    for interval in re.findall(r"\d+ \[[\d, ]+\]", " ".join(scores)):
        average, limits = interval.split(" ", 1)
        assert re.search(rf"\b{average}\b.{{0,12}}{re.escape(limits)}", results), interval
    for errors in re.findall(r"\d+ / \d+", " ".join(scores)):
        assert errors in results
