import dataclasses
import os

import pytest
import torch
from torch import nn

from sightline.export import kept_files
from sightline.export.graph import ExportGraph
from sightline.export.kept_files import onnx_file_of
from sightline.ops.cache_folder import cache_folder
from tests.export.networks import METADATA


@pytest.fixture
def exported(tmp_path, monkeypatch):
    """Fake exports: each gives other bytes, without the seconds of a real one."""
    made = []

    def export(graph):
        made.append(graph)
        return f"file {len(made)}".encode()

    monkeypatch.setattr(kept_files, "_export", export)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return made


def graph_of(module=None, **changes):
    module = module or nn.Linear(2, 3)
    graph = ExportGraph(
        module=module.eval(),
        example_inputs={"input": torch.zeros(1, 2)},
        metadata=METADATA,
        cases=dict,
        max_difference=0.0,
    )
    return dataclasses.replace(graph, **changes)


def test_a_network_is_exported_once(exported):
    graph = graph_of()
    assert onnx_file_of(graph) == onnx_file_of(graph) == b"file 1"
    assert len(exported) == 1
    assert len(list(cache_folder().iterdir())) == 1


def test_a_network_is_exported_once_where_kept_files_may_not_be_touched(exported, monkeypatch):
    def refuse(*_):
        raise PermissionError

    graph = graph_of()
    onnx_file_of(graph)
    monkeypatch.setattr(os, "utime", refuse)
    assert onnx_file_of(graph) == b"file 1"
    assert len(exported) == 1


@pytest.mark.usefixtures("exported")
def test_whatever_the_file_is_made_from_makes_another_file(monkeypatch):
    torch.manual_seed(0)
    graph = graph_of()
    others = [
        graph_of(nn.Linear(2, 3)),  # other weights
        dataclasses.replace(graph, metadata=dataclasses.replace(METADATA, config={"x": 1})),
        dataclasses.replace(graph, example_inputs={"input": torch.zeros(2, 2)}),
        dataclasses.replace(graph, example_inputs={"given": torch.zeros(1, 2)}),
    ]
    onnx_file_of(graph)
    assert [onnx_file_of(each) for each in others] == [f"file {n}".encode() for n in range(2, 6)]
    monkeypatch.setattr(kept_files, "_code_digest", lambda: "another version")
    assert onnx_file_of(graph) == b"file 6"


@pytest.mark.usefixtures("exported")
def test_buffers_that_no_weights_file_holds_count_too():
    module = nn.Linear(2, 3)
    module.register_buffer("offset", torch.zeros(1), persistent=False)
    onnx_file_of(graph_of(module))
    module.offset += 1
    assert onnx_file_of(graph_of(module)) == b"file 2"


@pytest.mark.usefixtures("exported")
def test_modules_whose_code_is_not_known_are_exported_every_time():
    class Own(nn.Module):
        pass

    graph = graph_of(Own())
    assert onnx_file_of(graph) != onnx_file_of(graph)
    assert not list(cache_folder().iterdir())


@pytest.mark.parametrize("length", [0, 20, 37])
@pytest.mark.usefixtures("exported")
def test_a_damaged_file_is_made_anew(length):
    graph = graph_of()
    onnx_file_of(graph)
    (path,) = cache_folder().iterdir()
    path.write_bytes(path.read_bytes()[:length])
    assert onnx_file_of(graph) == onnx_file_of(graph) == b"file 2"


@pytest.mark.usefixtures("exported")
def test_where_nothing_can_be_kept_it_goes_without(monkeypatch):
    monkeypatch.setattr(kept_files, "cache_folder", lambda: None)
    graph = graph_of()
    assert onnx_file_of(graph) != onnx_file_of(graph)


@pytest.mark.usefixtures("exported")
def test_the_files_used_last_are_kept(monkeypatch):
    monkeypatch.setattr(kept_files, "_MAX_FILES", 2)
    graphs = [graph_of(nn.Linear(2, 3)) for _ in range(3)]
    for age, graph in enumerate(graphs[:2]):
        onnx_file_of(graph)
        for path in cache_folder().iterdir():
            os.utime(path, (age, age))
    assert onnx_file_of(graphs[0]) == b"file 1"  # now the younger one
    onnx_file_of(graphs[2])
    assert len(list(cache_folder().iterdir())) == 2
    assert onnx_file_of(graphs[0]) == b"file 1"
    assert onnx_file_of(graphs[1]) == b"file 4"
