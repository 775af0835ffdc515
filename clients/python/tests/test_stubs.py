"""The stubs match the module and its arguments, and everything has a docstring."""

import ast
import inspect
import pathlib

import pytest

import haptic_bridge
from haptic_bridge import _native

STUB = pathlib.Path(haptic_bridge.__file__).with_name("_native.pyi")


def test_stubs_and_module_have_the_same_names():
    tree = ast.parse(STUB.read_text())
    declared = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    public = {name for name in declared if not name.startswith("_")}
    assert public | {"__version__"} == {name for name in haptic_bridge.__all__ if name != "mjcf"}
    for name in public:
        actual, node = getattr(_native, name), declared[name]
        assert actual.__doc__, name
        if isinstance(node, ast.FunctionDef):
            compare(actual, node)
            continue
        own = {member.name: member for member in node.body if isinstance(member, ast.FunctionDef)}
        if name.endswith("Error"):
            continue
        assert {key for key in vars(actual) if not key.startswith("_")} == {key for key in own if not key.startswith("_")}, name
        for key, member in own.items():
            if key in ("__init__", "__enter__", "__exit__", "__len__", "__getitem__", "__iter__", "__contains__"):
                continue
            attribute = getattr(actual, key)
            assert attribute.__doc__, f"{name}.{key}"
            if not any(isinstance(mark, ast.Name) and mark.id == "property" for mark in member.decorator_list):
                compare(attribute, member)


def compare(function, node):
    names = [argument.arg for argument in [*node.args.args, *node.args.kwonlyargs]]
    assert list(inspect.signature(function).parameters) == names, node.name


def test_the_readme_example_passes_mypy(tmp_path, monkeypatch):
    mypy = pytest.importorskip("mypy.api")
    readme = (pathlib.Path(__file__).parents[1] / "README.md").read_text()
    example = tmp_path / "example.py"
    example.write_text(readme.split("```python\n")[1].split("```")[0])
    monkeypatch.setenv("MYPYPATH", str(STUB.parents[1]))
    options = ["--strict", "--follow-imports=silent", f"--cache-dir={tmp_path}"]
    report, errors, status = mypy.run([*options, str(example)])
    assert status == 0, report + errors
