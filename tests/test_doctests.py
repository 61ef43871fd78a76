"""The examples in the docstrings print what they say."""

import doctest
import importlib
import pkgutil

import numpy as np
import pytest

import truestroke

NATIVE = {"truestroke._kernel", "truestroke._kernel32", "truestroke._plant"}
MODULES = ["truestroke"] + [
    m.name for m in pkgutil.walk_packages(truestroke.__path__, "truestroke.") if m.name not in NATIVE
]
MODULES += ["benchmarks.bench.cost", "benchmarks.singularity_free_inverse"]


@pytest.mark.usefixtures("no_waiting")
@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples(name: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("linecache.checkcache", lambda filename=None: None)  # of all files, before each docstring
    module = importlib.import_module(name)
    failures, _ = doctest.testmod(module, extraglobs={"np": np, "truestroke": truestroke})
    assert failures == 0
