"""Installation without ROS packages: the engine runs, and the guide names its requirements."""

import ast
import importlib
import importlib.metadata
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from programs import python

from train_ato.cli import main

ROOT = Path(__file__).resolve().parents[1]
PLAN = ["plan", "level", "xuzhou_metro_3", "--to-km", "1", "--time", "200"]


def declared() -> list[str]:
    """Return the requirements of the package without those of ROS."""
    calls = [node for node in ast.walk(ast.parse((ROOT / "setup.py").read_text())) if isinstance(node, ast.keyword)]
    (found,) = [node.value for node in calls if node.arg == "install_requires"]
    assert isinstance(found, ast.List)
    return [entry.value for entry in found.elts if isinstance(entry, ast.Constant)]


def closure(requirements: list[str]) -> dict[str, importlib.metadata.Distribution]:
    """Return the installed distributions of requirements, with their dependencies."""
    found: dict[str, importlib.metadata.Distribution] = {}
    waiting = list(requirements)
    while waiting:
        wanted = Requirement(waiting.pop())
        key = re.sub(r"[-_.]+", "-", wanted.name).lower()
        if key not in found and (wanted.marker is None or wanted.marker.evaluate({"extra": ""})):
            found[key] = importlib.metadata.distribution(wanted.name)
            waiting += found[key].requires or []
    return found


@pytest.mark.campaign
def test_the_engine_runs_where_no_ros_package_is_installed(tmp_path):
    """Breaks if the engine, a table or the help needs ROS, a requirement is undeclared, or an error omits ROS."""
    site = tmp_path / "site"
    site.mkdir()
    for distribution in closure(declared()).values():
        for top in {Path(file).parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            place = Path(distribution.locate_file(top))
            if place.exists() and not (site / top).exists():
                (site / top).symlink_to(place)
    start = f"import sys; sys.path[:0] = [{str(site)!r}, {str(ROOT)!r}]\n"

    def python(code):
        return subprocess.run(
            [sys.executable, "-I", "-S", "-c", start + code], cwd=tmp_path, capture_output=True, text=True, check=False
        )

    def command(*arguments):
        return python(f"from train_ato.cli import main; sys.exit(main({list(arguments)!r}))")

    assert "No module named 'rclpy'" in python("import rclpy").stderr
    done = python(
        "import train_ato as ta; run = ta.run('demo', set={'duration': 20})\n"
        "print(len(run['train/measurement'])); run.save('saved')\n"
    )
    assert (done.returncode, done.stdout) == (0, "200\n"), done.stderr
    for arguments in (
        ["run", "demo", "--engine", "--set", "duration=20", "--out", "run"], ["--help"], ["list"], ["info", "run"],
        ["verify", "saved"], [*PLAN, "--no-bound"],
        ["compare", "demo", "--laws", "pid,smc", "--set", "duration=10", "--out", "laws"],
    ):  # fmt: skip
        done = command(*arguments)
        assert done.returncode == 0, (arguments, done.stderr)
    assert "without comparison.html: bokeh, Jinja2 are not installed" in done.stderr
    assert (tmp_path / "laws" / "figure.png").exists()
    for arguments in (
        ["run", "demo"], ["run", "demo", "--processes"], ["param", "law=smc"], ["inject", "pause"],
        ["replay", "run"],
    ):  # fmt: skip
        done = command(*arguments)
        assert done.returncode == 2, (arguments, done.stderr)
        assert len(done.stderr.splitlines()) == 1 and "ROS 2 is not installed" in done.stderr, (arguments, done.stderr)
    done = python("import train_ato as ta; ta.run('demo', mode='composed')")
    assert "InputError: ROS 2 is not installed (no rclpy); run the engine" in done.stderr


@pytest.mark.parametrize("mode", ["composed", pytest.param("processes", marks=pytest.mark.graph)])
def test_ros_that_does_not_load_is_refused_with_the_remedy(mode, tmp_path):
    """Breaks if a library that is missing gives a traceback, another exit status than 2, or an empty run folder."""
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("raise ImportError('librcl.so: cannot open shared object file')\n")
    words = ["-m", "train_ato", "run", "demo", "--out=run", *["--processes"][: mode == "processes"]]
    done = python(*words, folder=tmp_path, PYTHONPATH=f"{tmp_path}{os.pathsep}{ROOT}")
    said = done.stderr.splitlines()[-1]
    assert said.startswith("train-ato: ROS 2 does not load (librcl.so: cannot open shared object file); run the engine")
    assert (done.returncode, "Traceback" in done.stderr, done.stdout) == (2, False, "")
    assert mode == "processes" or not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "packages"),
    [
        (["report", "runs/demo-1"], "bokeh Jinja2"),
        (["view", "runs/demo-1"], "bokeh Jinja2 tornado"),
        (["view", "runs/demo-1", "--foxglove"], "bokeh Jinja2 tornado foxglove-sdk"),
        (PLAN, "scipy"),
        (["export", "runs/demo-1", "--csv"], "pyarrow"),
        (["run", "demo", "--engine"], "matplotlib"),
    ],
)
def test_a_missing_extra_is_refused_with_its_command(arguments, packages, monkeypatch, capsys):
    """Breaks if a command without its packages fails with a traceback, starts its work, or names too few packages."""
    for module in ("bokeh", "jinja2", "tornado", "foxglove", "scipy", "pyarrow", "matplotlib"):
        monkeypatch.setitem(sys.modules, module, None)
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1
    assert said.err.endswith(f"not installed; run `pip install {packages}`\n")


@pytest.mark.parametrize(
    ("words", "package", "text"),
    [
        (["curves", "demo", "--out=curves.png"], "matplotlib", "raise ImportError('no libpng')"),
        (["list"], "pydantic", "import no_such_module"),
    ],
)
def test_a_required_package_that_does_not_load_is_named_with_its_command(words, package, text, tmp_path):
    """Breaks if a package that is damaged or too old gives a traceback."""
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text(f"{text}\n")
    done = python("-m", "train_ato", *words, folder=tmp_path, PYTHONPATH=f"{tmp_path}{os.pathsep}{ROOT}")
    (said,) = done.stderr.splitlines()
    assert re.fullmatch(
        rf"train-ato: {package} does not load \(.*n?o.*\); run `pip install --force-reinstall {package}`", said
    )
    assert (done.returncode, done.stdout) == (2, "")


def test_the_guide_installs_every_requirement_without_ros():
    guide = (ROOT / "msgs_docs" / "guide.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"pip install --no-deps \. && pip install ((?:[^\\\n]|\\\n)*)", guide)
    assert sorted(line.replace("\\\n", " ").split()) == sorted(Requirement(entry).name for entry in declared())
