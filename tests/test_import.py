"""The package's face: its names, where they live, and what an import loads."""

import ast
import pickle
import pkgutil
import subprocess
import sys
import types
from importlib.metadata import version
from pathlib import Path

import pytest

import imgscale as ims

HEAVY = {
    "scipy", "skimage", "PIL", "matplotlib", "torch", "cv2", "pandas", "csv", "argparse",
    "statistics",
}  # fmt: skip
LATER = {
    "imgscale.core", "imgscale.explaining", "imgscale.fitting", "imgscale.many", "imgscale.model",
    "imgscale.prediction", "imgscale.record", "json", "pathlib", "traceback", "urllib.parse",
}  # fmt: skip


def run(code):
    """What a fresh interpreter prints."""
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


def loaded_after(statement):
    """Modules in `sys.modules` of a fresh interpreter that ran a statement."""
    return set(run(f"import sys\n{statement}\nprint(*sys.modules)").split())


def checkers_imports():
    """The names that a type checker sees and their modules."""
    tree = ast.parse(Path(ims.__file__).read_text(encoding="utf-8"))
    return {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("imgscale.")
        for alias in node.names
    }


# --- names ---


def test_all_lists_exactly_the_public_names():
    public = {
        name
        for name in dir(ims)
        if not name.startswith("_")
        and name != "annotations"
        and not isinstance(getattr(ims, name), types.ModuleType)
    }
    assert set(ims.__all__) == public
    assert list(ims.__all__) == sorted(ims.__all__)


def test_the_designs_names_are_there():
    names = {
        "Camera", "Depth", "DepthMap", "DepthMismatchError", "DepthSource", "Detection", "Detector",
        "FitError", "Flag", "Frame", "GroundPlane", "ImgscaleError", "Measurement",
        "MissingDependencyError", "Noise", "ObjectDepths", "ObjectPrior", "PriorTable", "Reference",
        "ScaleModel", "SizeEstimate", "fit", "leave_one_out", "measure", "predict",
    }  # fmt: skip
    assert names <= set(ims.__all__)


def test_type_checkers_are_told_of_every_name_where_it_is_loaded_from():
    told = checkers_imports()
    assert sorted(told) == ims.__all__
    assert {name: told[name] for name in ims._HOMES} == {
        name: f"imgscale.{home}" for name, home in ims._HOMES.items()
    }


@pytest.mark.parametrize("name", sorted(set(ims.__all__) - {"Depth"}))
def test_a_name_is_the_object_of_its_module(name):
    one = getattr(ims, name)
    assert one is getattr(sys.modules[one.__module__], name)
    assert one is pickle.loads(pickle.dumps(one))  # noqa: S301 - our own


def test_a_star_import_binds_every_name():
    found = {}
    exec("from imgscale import *", found)  # noqa: S102 - only a module's own level allows a star
    assert {name: found[name] for name in ims.__all__} == {
        name: getattr(ims, name) for name in ims.__all__
    }


def test_dir_tells_names_that_are_not_loaded_yet():
    listed = run("import imgscale; print(*dir(imgscale))").split()
    assert {*ims.__all__, "__version__"} <= set(listed)
    assert listed == sorted(set(listed))


def test_no_name_hides_a_module():
    modules = {module.name for module in pkgutil.iter_modules(ims.__path__)}
    assert len(modules) > 40
    assert not modules & set(ims.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'imgscale' has no attribute 'fitt'"):
        ims.fitt  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'fitt' from 'imgscale'"):
        from imgscale import fitt  # noqa: F401, PLC0415


def test_a_name_can_be_replaced_before_it_was_asked_for():
    code = (
        "import imgscale\nfrom unittest import mock\n"
        "with mock.patch('imgscale.fit', 7): print(imgscale.fit)\n"
        "print(imgscale.fit.__module__)"
    )
    assert run(code).split() == ["7", "imgscale.fitting"]


def test_the_version_is_that_of_the_installed_package():
    assert ims.__version__ == version("imgscale")


# --- what is loaded, and when ---


@pytest.mark.parametrize("statement", ["import imgscale", "from imgscale import *"])
def test_importing_the_package_loads_numpy_and_attrs_only(statement):
    # what numpy and attrs bring in themselves is theirs
    more = loaded_after(statement) - loaded_after("import numpy, attrs")
    assert not {name.partition(".")[0] for name in more} & HEAVY


def test_what_not_every_user_needs_is_loaded_when_it_is_asked_for():
    more = loaded_after("import imgscale") - loaded_after("import numpy, attrs")
    assert "imgscale.detection" in more
    assert not more & LATER
    assert "imgscale.fitting" in loaded_after("import imgscale; imgscale.fit")


def test_threads_that_ask_at_once_get_the_same_objects():
    code = """
import random, threading
import imgscale
found, start = [], threading.Barrier(8)
def ask(seed):
    names = random.Random(seed).sample(imgscale.__all__, len(imgscale.__all__))
    start.wait()
    found.append({name: id(getattr(imgscale, name)) for name in names})
threads = [threading.Thread(target=ask, args=(seed,)) for seed in range(8)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(len(found), all(one == found[0] for one in found))
"""
    assert run(code).split() == ["8", "True"]


def test_what_another_process_pickled_is_loaded_without_the_package_being_asked():
    names = sorted(set(ims.__all__) - {"Depth"})
    blob = pickle.dumps([getattr(ims, name) for name in names])
    code = f"import pickle; print(*(one.__name__ for one in pickle.loads({blob!r})))"
    assert run(code).split() == names
