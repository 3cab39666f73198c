"""Python interface: `import train_ato as ta`, runs, laws without registration, comparisons."""

import doctest
import importlib
import importlib.metadata
import inspect
import json
import pickle
import pydoc
import signal
import sys
import threading
import types
import warnings
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from programs import python

import train_ato as ta
from plant_sim.line import Line
from train_ato.api import progress
from train_ato.cli.list import catalogue
from train_ato.cli.main import main
from train_ato.control.contract import LawOutput, parameter
from train_ato.control.registry import LAWS
from train_ato.judge.motion_difference import DrivenMotion, motion_difference
from train_ato.program.errors import refusing
from train_ato.scenario.scenario import check_scenario

ROOT = Path(__file__).resolve().parents[1]
SHORT = {"duration": 20}


@dataclass
class Gain:
    """Feed-forward and gain, as defined in a notebook."""

    gain: float = parameter(0.1, "1/s", 0.0, 10.0, "gain on the speed error")

    def bind(self, model, period):
        self.inertia = model.inertia

    def reset(self):
        pass

    def step(self, inputs):
        force = inputs.feedforward - self.gain * self.inertia * (inputs.velocity - inputs.reference_velocity)
        return LawOutput(np.clip(force, inputs.force_min, inputs.force_max))


class Plain(Gain):
    """The same law with a constructor."""

    def __init__(self, gain=0.1):
        self.gain = gain


def local(factor=1.0):
    """Return a class of a function, as a notebook cell that is run again gives one."""

    class Same(Gain):
        def step(self, inputs):
            return LawOutput(super().step(inputs).force * factor)

    return Same


class Breaking(Gain):
    """Raise an error after two seconds."""

    def step(self, inputs):
        if inputs.t > 2.0:
            raise ZeroDivisionError("late")
        return super().step(inputs)


class Pressing(Gain):
    """Interrupt after two seconds, as Ctrl-C does."""

    def step(self, inputs):
        if inputs.t > 2.0:
            signal.raise_signal(signal.SIGINT)
        return super().step(inputs)


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    """Change to an empty folder with a law in a module; return the name of the module."""
    head = "from dataclasses import dataclass\nimport numpy as np\n"
    head += "from train_ato.control.contract import LawOutput, parameter\n"
    (tmp_path / "own_law.py").write_text(head + inspect.getsource(Gain).replace("class Gain", "class Own"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(LAWS, "_unregistered", {})
    yield "own_law"
    sys.modules.pop("own_law", None)


def same_tables(one, other):
    assert list(one.keys()) == list(other.keys())
    for topic in one.keys():  # noqa: SIM118 - a run is no dict
        pd.testing.assert_frame_equal(one[topic], other[topic], check_exact=True)


def test_a_run_is_measured_drawn_and_saved(tmp_path, capsys):
    """Breaks if a call of the example in the guide fails, or a saved run is incomplete."""
    run = ta.run("demo", law="smc", set={"laws.smc.ks": 0.0, **SHORT})
    assert run.metrics["speed_rmse_kmh"] > 0 and run.metrics["controller"] == "smc"
    assert run.path is None and capsys.readouterr() == ("", "")
    assert len(run.plot().axes) >= 4 and run.plot()._repr_png_().startswith(b"\x89PNG")
    assert run.report().stat().st_size > 1e5
    folder = run.save(tmp_path / "runs" / "x")
    assert {"run.mcap", "metadata.yaml", "scenario.yaml", "summary.json", "figure.png"} <= {
        path.name for path in folder.iterdir()
    }
    same_tables(run, ta.load(folder))
    same_tables(ta.open_run(folder), run)
    assert ta.open_run(folder).metrics == run.metrics
    assert len(ta.open_run(folder).plot().axes) == len(run.plot().axes)
    assert main(["verify", str(folder)]) == 0
    with pytest.raises(ValueError, match=r"save .*x: exists already"):
        run.save(folder)
    assert run.save(tmp_path / "copy") == tmp_path / "copy" and folder.is_dir()


def test_the_record_is_the_same_wherever_it_is_held(tmp_path, monkeypatch):
    """Breaks if a log written during or after the run differs from one written from the start."""
    held = ta.run("demo", set=SHORT)
    recorded = ta.run("demo", set=SHORT, out=tmp_path / "run")
    assert recorded.path == tmp_path / "run" and (tmp_path / "run" / "figure.png").is_file()
    monkeypatch.setattr("train_ato.api.run.MESSAGES_IN_MEMORY", 500)
    spilt = ta.run("demo", set=SHORT)
    same_tables(held, recorded)
    same_tables(held, spilt)
    left = Path(spilt.folder())
    del spilt
    assert not left.exists()


@pytest.mark.usefixtures("without_figure")
def test_laws_need_no_registration(own_module, capsys):
    """Breaks if a law object, its class and its name differ, or a class of a registered law loses its parameters."""
    run = ta.run("demo", law=Gain(gain=0.3), set=SHORT)
    name = f"{__name__}:Gain"
    assert run.metrics["controller"] == name
    by_name = ta.run("demo", law=Gain, set={f"laws.{name}.gain": 0.3, **SHORT})
    same = ("speed_rmse_kmh", "coupler_draft_max_kn", "energy_traction_kwh")
    for other in (by_name, ta.run("demo", law=Plain(np.float64(0.3)), set=SHORT)):
        assert [other.metrics[key] for key in same] == [run.metrics[key] for key in same]
    assert ta.run("demo", law=Gain, set=SHORT).metrics["speed_rmse_kmh"] != run.metrics["speed_rmse_kmh"]
    arguments = ["run", "demo", "--engine", "--law", f"{own_module}:Own", "--set=duration=20", "--json"]
    assert main([*arguments, "--set", f"laws.{own_module}:Own.gain=0.3"]) == 0
    found = yaml.safe_load(capsys.readouterr().out)
    assert found["speed_rmse_kmh"] == run.metrics["speed_rmse_kmh"]
    from train_ato.control.laws.smc import Smc

    assert ta.run("demo", law=Smc, set=SHORT).metrics["controller"] == "smc"


def test_the_template_takes_its_parameters_as_keywords(monkeypatch):
    """Breaks if examples/my_law.py does not run as described in it."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    my_law = importlib.import_module("my_law")
    run = ta.run("demo", law=my_law.MyLaw(gain=0.2), set=SHORT)
    assert run.setup.scenario.laws["my_law:MyLaw"]["gain"] == 0.2
    assert ta.compare("demo", [my_law.MyLaw], set=SHORT).table["status"].tolist() == ["done"]


@pytest.mark.parametrize(("scenario", "components"), [
    ("demo", {"law": "my_law:MyLaw"}),
    pytest.param("demo", {"law": "my_law:MyLaw", "laws.my_law:MyLaw.gain": 0.04}, marks=pytest.mark.slow),
    pytest.param("demo", {"law": "my_planning_law:MyPlanningLaw"}, marks=pytest.mark.slow),
    pytest.param("crh380a_gpc:short", {"law": "my_planning_law:MyPlanningLaw", "compensation": "preview"},
        marks=pytest.mark.slow),
    pytest.param("demo", {"compensation": "my_compensation:MyCompensation"}, marks=pytest.mark.slow),
    pytest.param("demo", {"observer": "my_observer:MyObserver"}, marks=pytest.mark.slow),
    pytest.param("demo", {"observer": "my_observer:MyObserver", "compensation": "my_compensation:MyCompensation"},
        marks=pytest.mark.slow),
])  # fmt: skip
def test_every_template_passes_where_its_docstring_runs_it(monkeypatch, scenario, components):
    """Breaks if a template oscillates, misses a criterion or the stop: it would teach the wrong gains."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    whole = ta.run(scenario, set=components)
    assert (whole.metrics["tracking"], whole.metrics["verdict"]) == ("tracked", "passed")


def test_a_class_that_is_defined_again_replaces_the_first():
    """Breaks if a second run of a notebook cell uses the first version of the law."""
    strong, weak = ta.run("demo", law=local(), set=SHORT), ta.run("demo", law=local(0.5), set=SHORT)
    assert strong.metrics["controller"] == weak.metrics["controller"]
    assert weak.metrics["energy_traction_kwh"] < 0.9 * strong.metrics["energy_traction_kwh"]
    table = ta.compare("demo", [local(), local(0.5)], set=SHORT).table
    energies = [run.metrics["energy_traction_kwh"] for run in (weak, strong)]
    assert sorted(table["energy_traction_kwh"]) == energies


def test_a_saved_run_with_a_law_of_its_own_is_verified_or_refused(own_module, tmp_path):
    """Breaks if verify uses another law, its refusal has no remedy, or the tables need the law."""
    found = ta.run("demo", law=f"{own_module}:Own", set={"duration": 5}).save("found")
    done = python("-m", "train_ato", "verify", str(found), folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and "are equal" in done.stdout
    lost = ta.run("demo", law=local()(0.2), set={"duration": 5}).save("lost")
    done = python("-m", "train_ato", "verify", str(lost), folder=tmp_path)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "Same: a class of a script, a notebook or a function is in no module; move it into one" in done.stderr
    code = f"import train_ato as ta; run = ta.open_run({str(lost)!r}); print(len(run['ato/command']), run)"
    assert python("-c", code).stdout.startswith("50 <Run demo")


class NoReset:
    def step(self, inputs):
        return LawOutput(inputs.feedforward)


class NoDefault(Gain):
    def __init__(self, gain):
        self.gain = gain


class NotKept(Gain):
    def __init__(self, gain=0.1, more=1.0):
        self.gain = gain


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"law": "smcc"}, r"demo\.yaml: unknown law 'smcc'; did you mean 'smc'\?"),
        ({"law": 3}, r"law 3: give a name, 'module:Class', a class or an object"),
        ({"law": NoReset}, r"class NoReset has no method reset\(\)"),
        ({"law": NoDefault}, r"parameter 'gain' needs a default"),
        (
            {"law": type("Bare", (Gain,), {"Parameters": int})},
            r"Parameters = <class 'int'>: is no dataclass; write @data",
        ),
        (
            {"law": type("Bare", (Gain,), {"Parameters": make_dataclass("P", [("k", float, 1.0)])})},
            r"class P: field 'k' is not declared; write k: float = parameter\(\.\.\.\)",
        ),
        ({"law": NotKept()}, r"NotKept does not keep its parameter 'more'; set self\.more"),
        ({"law": Gain(gain=11.0)}, r"Gain\.gain: 11 is outside 0 \.\.\. 10 1/s"),
        ({"law": "no_such_module:Law"}, r"module 'no_such_module' cannot be imported"),
        ({"law": "__main__:Law"}, r"Law: a class of a script.* is in no module.*my_law\.py"),
        ({"set": {"law": NotKept()}}, r"law = NotKept.*: is an object of Python; write a text or a number"),
        ({"out": "a\0b"}, "^a name has a null character; remove it$"),
        ({"law": Gain, "mode": "processes", "set": {"plant": 1}}, r"plant = 1"),
        (
            {"law": local()(), "mode": "processes"},
            "mode 'processes': another process cannot import the law: .*my_law:MyLaw",
        ),
        ({"mode": "thread"}, r"mode 'thread': choose from engine, composed, processes"),
        ({"rate": 0}, r"^rate 0: give a number above 0"),
        ({"restarts": 1}, r"^restart: only a node in a process of its own can be restarted"),
        ({"mode": "processes", "restarts": -1}, r"^restarts -1: give 1 or more, or 0 for none"),
        ({"set": {"seed.a": 1}}, r"set seed\.a: 'seed' is a value, not a block of keys"),
        ({"set": {"laws.pid.kpp": 1}}, r"pid\.kpp: no such parameter; did you mean 'kp'\?"),
        ({"seed": -1}, r"seed = -1"),
        ({"out": "."}, r"^out \.: exists already"),
    ],
)
def test_bad_input_is_refused_in_one_line(options, message, tmp_path, monkeypatch):
    """Breaks if a wrong argument starts a run, leaves a folder, or has no error with a remedy."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message) as caught:
        ta.run("demo", **options)
    assert "\n" not in str(caught.value) and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["law", "observer"])
def test_an_object_without_parameters_is_the_object_that_runs(kind: str) -> None:
    """Breaks if an object whose constructor takes nothing ends in a KeyError, or another object runs in its place."""

    class Counting:
        def __init__(self) -> None:
            self.steps = 0

        def reset(self) -> None:
            """Nothing to clear."""

        def step(self, inputs: Any) -> Any:
            self.steps += 1
            force = np.zeros(len(inputs.velocity))
            return LawOutput(force=force) if kind == "law" else force

    counting: Any = Counting()
    run = ta.run("demo", **{kind: counting}, set=SHORT, progress=False)
    assert counting.steps == run.metrics["ticks"] > 0


@pytest.mark.parametrize("method", ["__init__", "bind", "reset"])
@pytest.mark.parametrize("option", ["law", "observer"])
def test_an_error_at_the_start_of_an_own_component_has_its_file_and_line(
    option: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a constructor, ``bind`` or ``reset`` of a user ends the command with a traceback."""
    methods = {"__init__": "(self)", "bind": "(self, model, period)", "reset": "(self)", "step": "(self, inputs)"}
    module = f"starts_{option}_{method.strip('_')}"
    lines = ["class Own:"]
    for name, given in methods.items():
        lines += [f"    def {name}{given}:", "        1 / 0" if name == method else "        pass"]
    (tmp_path / f"{module}.py").write_text("\n".join(lines))
    monkeypatch.chdir(tmp_path)
    assert main(["run", "demo", "--engine", f"--{option}", f"{module}:Own", "--set", "duration=2", "--out", "a"]) == 2
    err = capsys.readouterr().err
    place = f"{tmp_path / module}.py:{lines.index('        1 / 0') + 1}"
    assert f"{option} Own: ZeroDivisionError: division by zero, {place}\n" in err and len(err.splitlines()) == 1
    (tmp_path / f"{module}_all.py").write_text("\n1 / 0\n")
    assert main(["run", "demo", "--engine", f"--{option}", f"{module}_all:Own", "--out", "a"]) == 2
    assert f"ZeroDivisionError: division by zero, {tmp_path / module}_all.py:2" in capsys.readouterr().err


@pytest.mark.usefixtures("without_figure")
@pytest.mark.parametrize(("law", "error", "status"), [(Breaking, ta.RunFailed, "failed"),
                                                     (Pressing, KeyboardInterrupt, "interrupted")])  # fmt: skip
@pytest.mark.parametrize("kept", [True, False])
def test_a_run_that_does_not_end_well_keeps_its_record(law, error, status, kept, tmp_path):
    """Breaks if recorded data are lost after a failure or Ctrl-C, or a line names data where no folder has them."""
    with pytest.raises(error) as caught:
        ta.run("demo", law=law, set=SHORT, out=tmp_path / "run" if kept else None)
    assert isinstance(caught.value, ta.RunFailed) and "\n" not in str(caught.value)
    assert ("; recorded data: " in str(caught.value)) == (kept and status == "interrupted")
    run = caught.value.run
    sent = pickle.dumps(run)
    assert run.metrics["status"] == status
    # after a failure the last command is held for a second, then the run ends at standstill
    assert run["train/measurement"].index[-1] == pytest.approx(3.2 if status == "failed" else 2.1)
    assert ('raise ZeroDivisionError("late")' in run.traceback) == (status == "failed")
    assert run.plot().axes and run.save(tmp_path / "saved").is_dir()
    assert (run.path != tmp_path / "run") and (tmp_path / "run").exists() == kept
    assert ta.open_run(pickle.loads(sent).save(tmp_path / "sent")).setup.line == run.setup.line


def test_a_comparison_goes_on_after_a_refusal_and_a_failure(tmp_path):
    """Breaks if one failed law stops the others, or its row has no reason."""
    options = {"compensation": "twin", "set": SHORT}
    both = ta.compare("demo", ["pid", "lag_smc", Gain(0.2), Gain(gain=0.3), Breaking], out=tmp_path / "kept", **options)
    table = both.table
    ends = {
        "pid": "done", "lag_smc": "refused", "Gain(gain=0.2)": "done", "Gain(gain=0.3)": "done", "Breaking": "failed",
    }  # fmt: skip
    assert table["status"].to_dict() == ends
    assert sorted(table.index[3:]) == ["Breaking", "lag_smc"], "runs to the end are first"
    assert "'twin' gives only a feed-forward" in table.loc["lag_smc", "reason"]
    assert "ZeroDivisionError: late" in table.loc["Breaking", "reason"]
    alone = ta.run("demo", law=Gain(0.3), **options)
    for metric in ("speed_rmse_kmh", "verdict"):
        assert table.loc["Gain(gain=0.3)", metric] == alone.metrics[metric]
    assert len(both.plot(tmp_path / "figure.png").axes) == 5 and (tmp_path / "figure.png").is_file()
    assert "Gain(gain=0.2)" in both.report(tmp_path / "page.html").read_text()
    assert "&#x27;twin&#x27; gives only a feed-forward" in both._repr_html_() and "lag_smc (refused)" in repr(both)
    same_tables(ta.open_run(tmp_path / "kept" / "Gain(gain=0.3)"), alone)


@pytest.mark.parametrize(
    ("laws", "message"),
    [
        (["pid", "pidd"], r"unknown law 'pidd'; did you mean 'pid'\?"),
        (["lag_smc"], r"demo: no law fits this train: lag_smc: with compensation 'twin'"),
        ("pid", r"laws 'pid': give a list"),
        ([], r"laws: no law"),
    ],
)
def test_a_comparison_of_no_law_is_refused(laws, message):
    """Breaks if a misspelt law is detected after the runs of the others."""
    with pytest.raises(ValueError, match=message):
        ta.compare("demo", laws, compensation="twin", set=SHORT)


def test_the_command_compares_laws_of_modules(own_module, capsys):
    """Breaks if `compare` does not find a law of a module."""
    arguments = ["compare", "demo", "--set=duration=10", "--out=out"]
    assert main([*arguments, f"--laws=pid,{own_module}:Own"]) == 0
    assert f"{own_module}:Own" in capsys.readouterr().out


def test_a_scenario_is_changed_without_changing_it():
    """Breaks if a change modifies the original scenario, or is missing in the text."""
    demo = ta.scenario("demo")
    other = demo.with_({"laws.pid.kp": 0.03}, seed=7)
    assert (demo.checked.seed, other.checked.seed) == (1, 7)
    assert repr(other) == "scenario('demo').with_({'laws.pid.kp': 0.03, 'seed': 7})"
    data = yaml.safe_load(other.yaml)
    assert check_scenario(data, demo.path) == other.checked and data["laws"]["pid"]["kp"] == 0.03
    assert "laws" not in yaml.safe_load(demo.yaml)
    assert "ideal" in ta.scenario("daqin_heavy_haul").variants
    assert ta.scenario("daqin_heavy_haul:ideal").name == "daqin_heavy_haul:ideal"
    changes = {"interventions": [{"do": "delay_jump", "at": 9.0, "add": 1.0}], "interventions.0.at": 2.0}
    assert demo.with_(changes).checked.interventions[0].at == 2.0 and changes["interventions"][0]["at"] == 9.0
    with pytest.raises(ValueError, match=r"set seed=x: seed = 'x'"):
        demo.with_(seed="x")


def test_importing_the_package_is_light():
    """Breaks if the package or names in a shell load libraries, a run loads pandas, or dir() is incomplete."""
    code = (
        "import sys, train_ato as ta\n"
        "heavy = {'numpy', 'numba', 'matplotlib', 'pydantic', 'rclpy', 'pandas', 'rich', 'yaml'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "import plant_sim.library, train_ato.cli.completion, train_ato.scenario.scenario_files\n"
        "assert not {'numpy', 'numba', 'pydantic'} & set(sys.modules)\n"
        "import train_ato.api.drive\n"
        "assert not {'pandas', 'matplotlib', 'rclpy'} & set(sys.modules)\n"
        "assert set(ta.__all__) <= set(dir(ta)) and all(getattr(ta, name) is not None for name in ta.__all__)\n"
        "assert 'rclpy' not in sys.modules and callable(ta.scenario)\n"
        "import train_ato.scenario.scenario\n"
        "assert train_ato.scenario.scenario.load_scenario and ta.scenario('demo').name == 'demo'\n"
    )
    assert python("-c", code).returncode == 0
    assert ta.__version__ == importlib.import_module("train_ato.program.version").VERSION
    with pytest.raises(AttributeError, match="no attribute 'runn'"):
        ta.runn  # noqa: B018


MODULES = ["train_ato", "train_ato.scenario.overlays", "plant_sim.batch"] + [
    f"train_ato.{folder.replace('/', '.')}.{path.stem}"
    for folder in ("api", "api/env", "studies/sweep")
    for path in sorted((ROOT / "train_ato" / folder).glob("[a-z]*.py"))
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_are_right(name):
    """Breaks if an example of the reference fails or prints another result."""
    if name.endswith("gymnasium_env"):
        pytest.importorskip("gymnasium", reason="an extra: pip install 'train_ato[gymnasium]'")
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    assert found.failed == 0
    assert found.attempted > 0 or name not in ("train_ato", *MODULES[1:2])


def test_a_notebook_shows_runs_and_progress(monkeypatch, capsys):
    """Breaks if a run or a comparison has no table, or the progress bar of a notebook does not move."""
    shown: list[str] = []

    class Handle:
        def update(self, markup):
            shown.append(markup)

    def display(markup, display_id):
        shown.append(markup)
        return Handle()

    shell = types.SimpleNamespace(kernel=object())
    module = types.SimpleNamespace(display=types.SimpleNamespace(HTML=str, display=display), get_ipython=lambda: shell)
    monkeypatch.setitem(sys.modules, "IPython", module)
    assert progress.in_notebook()
    run = ta.run("demo", set={"duration": 60})
    assert len(shown) >= 2 and shown[0].startswith("demo <progress value='0.000'>") and "x real time" in shown[-2]
    assert shown[-1] == ""
    count = len(shown)
    ta.run("demo", set={"duration": 5}, progress=False)
    assert len(shown) == count and capsys.readouterr().err == ""
    assert "<td>speed error, rms in km/h</td>" in run._repr_html_()
    assert "train/measurement" in run._ipython_key_completions_()


def test_a_run_in_a_thread(tmp_path):
    """Breaks if a run outside the main thread installs signal handlers."""
    found = []
    thread = threading.Thread(target=lambda: found.append(ta.run("demo", set={"duration": 5})))
    thread.start()
    thread.join(120)
    assert found[0].metrics["status"] == "done"


@pytest.mark.usefixtures("without_figure")
@pytest.mark.parametrize("held", ["in memory", "in a temporary folder", "saved"])
def test_a_run_of_another_process_has_its_record(held: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a run from a worker needs the temporary or the present folder of the worker, or cannot be sent."""
    monkeypatch.chdir(tmp_path)
    run = ta.run("demo", set={"duration": 5}, out="run" if held == "saved" else None)
    if held == "in a temporary folder":
        assert "train/measurement" in run
    sent, command = pickle.dumps(run), run["ato/command"]
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always", ResourceWarning)
        del run  # with its temporary folder
    assert noted == []
    monkeypatch.chdir("/")
    same = pickle.loads(sent)
    assert same["ato/command"].equals(command) and same.plot().axes
    assert same.path == (tmp_path / "run" if held == "saved" else None)
    assert same.save(tmp_path / "copy") == tmp_path / "copy" and ta.verify(tmp_path / "copy").equal


@pytest.mark.usefixtures("without_figure")
def test_a_saved_run_that_is_moved_is_named(tmp_path: Path) -> None:
    """Breaks if the reading of a table tries to write the log again."""
    run = ta.run("demo", set={"duration": 5}, out=tmp_path / "run")
    (tmp_path / "run").rename(tmp_path / "moved")
    with pytest.raises(ta.InputError, match=r"run: is no longer there; open its present place with open_run\(\)"):
        run["train/measurement"]
    assert not (tmp_path / "run").exists()


def test_python_has_the_commands_of_the_shell(tmp_path: Path) -> None:
    """Breaks if a function of Python differs from its command, accepts what that refuses, or has no help of its own."""
    found = ta.plan("xuzhou_metro_test", "xuzhou_metro_3", end_km=1, out=tmp_path / "profile.csv", period=1)
    assert found.profile.position[-1] == pytest.approx(1000.0 - 118.0 / 2)  # centre of the train, front at km 1
    assert (tmp_path / "profile.csv").is_file()
    with pytest.raises(ValueError, match=r"jerkk: unknown key; did you mean 'jerk'"):
        ta.plan("xuzhou_metro_test", "xuzhou_metro_3", jerkk=1)
    with pytest.raises(ValueError, match="time with journey: the timing points have it"):
        ta.plan("xuzhou_metro_test", "xuzhou_metro_3", journey="none.yaml", time=100)
    assert ta.convert("level", tmp_path / "level.yaml")["kind"] == "line"
    kinds = (ta.laws, ta.observers, ta.compensations, ta.trains, ta.lines)
    assert [*catalogue().values()][2:] == [kind() for kind in kinds]
    text = pydoc.plain(pydoc.render_doc(ta.scenario))
    assert "function scenario" in text and "scenario(name" in text
    assert "law: " in pydoc.plain(pydoc.render_doc(ta.run)).partition("\n\n")[2].partition(" -> ")[0]


def test_a_scenario_is_a_name_a_dict_or_an_object() -> None:
    """Breaks if a function takes a scenario by its name only, or a dict loses its base or its refusals."""
    content = {"base": "demo", "duration": 5, "law": "smc"}
    by_dict, by_object = ta.run(content), ta.run(ta.scenario(content).checked)
    assert by_dict.metrics["controller"] == "smc" and content == {"base": "demo", "duration": 5, "law": "smc"}
    same_tables(by_dict, by_object)
    assert ta.compare(content, ["pid"]).laws[0].status == "done"
    assert ta.Env(content).reset()[1]["time"] >= 0
    with pytest.raises(ta.InputError, match=r"^scenario: duratio: unknown key; did you mean 'duration'"):
        ta.run({"base": "demo", "duratio": 5})
    with pytest.raises(ta.InputError, match=r"^set 'a=b': not a mapping"):
        ta.run("demo", set="a=b")


def test_a_result_is_typed_and_a_notebook_begins_with_the_verdict(tmp_path: Path) -> None:
    """Breaks if a value of the result differs from summary.json, or an object is shown without its verdict first."""
    hop = {"phases": [{"accelerate_to": 3.0}, {"brake_to": 0.0}]}
    short = ta.scenario("demo").with_({"profile": hop, "duration": 60, "plant.start": {}})
    run = ta.run(short, set={"criteria.stop_window": 0.001})
    failed, row = run.result.criteria[0], run.metrics["criteria"][0]
    assert (run.result.verdict, run.result.passed, failed.name, failed.passed) == (
        "failed", False, "stop_window", False,
    )  # fmt: skip
    assert (failed.value, failed.unit, failed.at_s, failed.km) == (row["value"], "m", row["at_s"], row["km"])
    assert [stop.beyond_m for stop in run.result.stops] == [failed.value]
    assert run.result.energy.traction_kwh == run.metrics["energy_traction_kwh"]
    assert ta.run("freight_consensus", set={"duration": 5, "criteria": {}}).result.verdict == "none"
    folder = ta.run("demo", set=SHORT, out=tmp_path / "run").folder()
    shown = {
        "failed": (run, run.result),
        "0 of 1 laws passed": (ta.compare(short, ["pid"]),),
        "equal: ": (ta.verify(folder),),
        "the same output in 200 of 200 ticks": (ta.replay(folder, "pid"),),
        "expected verdict: passed": (ta.scenario("demo"),),
        "planned in ": (ta.plan("xuzhou_metro_test", "xuzhou_metro_3", end_km=1),),
        "stable at 60 km/h": (model := ta.linearise("xuzhou_metro", speed_kmh=60),),
    }
    assert repr(model) == "stable at 60 km/h, besides the free place"
    env = ta.Env("xuzhou_metro", set={"duration": 0.2})
    titles = [env._repr_html_()]
    env.reset()
    titles.append(env._repr_html_())
    while not env.step(0.0)[2]:
        pass
    titles.append(env._repr_html_())
    words = ("xuzhou_metro: not begun", "xuzhou_metro: running, 0.0 s of 0.2 s", env.run.result.title)
    assert all(text.startswith(f"<p><b>{word}") for text, word in zip(titles, words, strict=True)), titles
    for verdict, objects in shown.items():
        assert all(entry._repr_html_().startswith(f"<p><b>{verdict}") for entry in objects), verdict


def test_a_run_is_a_dataset_of_xarray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a dimension mixes vehicles, a unit is missing, or a missing package is no refusal with its command."""
    run = ta.run("demo", set={"duration": 5})
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "xarray", None)
        with pytest.raises(ta.InputError, match=r"^to_xarray: .* not installed; install it: pip install xarray$"):
            run.to_xarray()
    pytest.importorskip("xarray", reason="an extra: pip install 'train_ato[xarray]'")
    force = run.to_xarray()["train_vehicles_vehicle_coupler_force_n"]
    assert force.attrs["units"] == "N" and force.sizes["vehicle"] == 106
    assert force.sel(vehicle=17).values.tolist() == run["train/vehicles"]["vehicle_17_coupler_force_n"].tolist()


@pytest.mark.usefixtures("without_figure")
def test_every_error_is_of_one_tree(tmp_path: Path) -> None:
    """Breaks if a refusal is no ``ta.Error``, a user's ValueError becomes one, or ``ta.verify`` compares nothing."""
    run = ta.run("demo", set={"duration": 5})
    found = ta.verify(run.save(tmp_path / "run"))
    assert found.equal and found.messages > 300
    for refused in (
        lambda: ta.run("demmo"),
        lambda: ta.scenario("demo").with_(duratio=3),
        lambda: run.save(tmp_path / "run"),
        lambda: run.report(tmp_path / "a.txt"),
        lambda: ta.Env("demmo"),
        lambda: ta.curves("demo", at_km=99),
        lambda: ta.import_run(tmp_path / "none.csv", train="hxd1_c80_105", line="level"),
        lambda: ta.replay(tmp_path / "run", "pid", set={"tick": 0.2}),
        lambda: ta.replay(tmp_path / "run", speed=2),
        lambda: ta.run("demo", rate="fast"),
        lambda: ta.replay(tmp_path / "run", rate="max"),
        lambda: ta.sweep({"scenario": "demo"}, jobs=2.5),
        lambda: ta.plan("level", "freight_five", out=None),
        lambda: ta.load(5),
        lambda: ta.difference(run, 5),
        lambda: ta.difference(run, run, step=1e-9),
        lambda: ta.run("demo", out=5),
        lambda: ta.run("demo", set={1: 2}),
        lambda: ta.compare("demo", 5),
        lambda: ta.tune("demo", "pid", weights=5),
        lambda: ta.sweep([]),
        lambda: ta.convert(5, "a.yaml"),
        lambda: ta.check_law("pid", kpp=3),
        lambda: ta.check_law(5),
        lambda: run.save("a\0b"),
        lambda: ta.verify(tmp_path / "run", 1),
    ):
        with pytest.raises(ta.InputError) as caught:
            refused()
        assert isinstance(caught.value, (ta.Error, ValueError)) and "\n" not in str(caught.value)
    assert "relative 1: out of range" in str(caught.value)  # of the last one
    assert issubclass(ta.RunInterrupted, ta.RunFailed) and issubclass(ta.RunFailed, ta.Error)

    with pytest.raises(ta.InputError, match=r"^at_km = \[1\]: give a number or a text or None$"):
        ta.curves("demo", at_km=[1])
    with pytest.raises(ta.InputError, match=r"^out = 5: give a path or None$"):
        run.plot(5)
    with pytest.raises(KeyError, match="no table '5'"):
        run[5]
    with pytest.raises(TypeError, match="unexpected keyword"):
        ta.compare("demo", ["pid"], no_such=1)
    with pytest.raises(ValueError, match="invalid literal") as raised:
        refusing(lambda: int("of a user"))()
    assert not isinstance(raised.value, ta.InputError)


@pytest.mark.usefixtures("without_figure")
def test_a_measured_run_and_braking_curves_are_those_of_the_commands(tmp_path: Path, capsys) -> None:
    """Breaks if ``ta.import_run`` or ``ta.curves`` has other numbers than its command."""
    arguments = ["examples/recorder.csv", "--consist", "xuzhou_metro_3", "--line", "level"]
    arguments[0] = str(ROOT / arguments[0])
    run = ta.import_run(arguments[0], train="xuzhou_metro_3", line="level", out=tmp_path / "a")
    assert main(["import", *arguments, "--out", str(tmp_path / "b")]) == 0
    same_tables(run, ta.load(tmp_path / "b"))
    capsys.readouterr()
    assert main(["curves", "demo", "--at-km", "3.5", "--json"]) == 0
    (found,) = ta.curves("demo", at_km=3.5).values()
    assert found == json.loads(capsys.readouterr().out)


@pytest.mark.usefixtures("without_figure")
def test_the_difference_of_two_runs_is_that_of_their_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a difference has the wrong sign, another place than the front's, or the stop of another station."""
    hop = {"phases": [{"accelerate_to": 3.0, "acceleration": 0.1}, {"cruise_for": 5}, {"brake_to": 0.0}]}
    first = ta.scenario("demo").with_({"profile": hop, "duration": 90, "plant.start": {}, "law": "pid"})
    one = ta.run(first, out=tmp_path / "one")
    later = ta.run(first, set={"profile": {"phases": [{"cruise_for": 4.0}, *hop["phases"]]}, "duration": 94})
    same, found = ta.difference(one, one), ta.difference(tmp_path / "one", later)
    assert not same.over_time.to_numpy().any() and not same.over_place.to_numpy().any()
    fronts = [run["train/vehicles"]["vehicle_0_position_m"] + one.setup.consist.vehicles[0].length / 2
              for run in (one, later)]  # fmt: skip
    place = float(found.over_place.index[8])
    passed = [float(np.interp(place, front, front.index)) for front in fronts]
    assert (
        found.over_place["time_s"].iloc[8] == pytest.approx(passed[1] - passed[0], abs=1e-6) and passed[1] > passed[0]
    )
    moment = float(found.over_time.index[300])
    behind = float(np.diff([np.interp(moment, front.index, front) for front in fronts])[0])
    assert found.over_time["position_m"].iloc[300] == pytest.approx(behind, abs=1e-6) and behind < -1
    assert same.stops["km"].tolist() == [stop.km for stop in one.result.stops]
    assert same.energy["energy_traction_kwh"] == 0
    assert same._repr_html_().startswith("<p><b>speed differs by up to 0 km/h")
    assert "traction energy by +0 kWh" in same.line and "two lines" not in capsys.readouterr().err
    ta.difference(one, ta.run(first, set={"plant.line": "level"}))
    assert "runs on two lines, 'daqin_section' and 'level'" in capsys.readouterr().err


def test_the_difference_of_two_runs_back_is_that_at_each_place_and_stop() -> None:
    """From 0 to 50 and back to -50 m at 5 m/s, the second one 2 s later: breaks if only the way on counts."""
    stops = [{"km": 0.0, "planned_s": at, "arrival_s": at, "delay_s": 0.0, "beyond_m": 0.0} for at in (9.0, 20.0)]
    seconds, motions = np.arange(31.0), []
    for late in (0.0, 2.0):
        moved = np.maximum(seconds - late, 0.0)
        front, rows = (
            50.0 - np.abs(50.0 - 5.0 * moved),
            [{**row, "arrival_s": row["arrival_s"] + late} for row in stops],
        )
        motions.append(DrivenMotion(seconds, front, np.full(31, 18.0), np.zeros(31), {"stops": rows}))
    found = motion_difference(*motions, step=10.0)
    assert found.place.tolist() == [-40.0, -30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    assert found.over_place["time_s"] == pytest.approx(np.where(found.place == 0.0, 0.0, 2.0))
    assert [row["difference_arrival_s"] for row in found.stops] == [2.0, 2.0]


def test_a_measured_train_stops_at_its_target_after_each_way() -> None:
    """Rest, 100 m on, rest, back to 0, rest, on, back, rest: breaks if a stop has the arrival of an earlier rest."""
    at = np.array([0.0, 10.0, 20.0, 40.0, 50.0, 60.0, 80.0, 90.0])
    time = np.arange(101.0)
    front = np.interp(time, at, [0.0, 100.0, 100.0, 0.0, 0.0, 100.0, 0.5, 0.5])
    speed = 3.6 * np.append(np.diff(front), 0.0)
    stops = [{"km": km, "planned_s": due, "arrival_s": due, "delay_s": 0.0, "beyond_m": 0.0}
             for km, due in ((0.1, 10.0), (0.0, 41.0), (0.0, 79.0))]  # fmt: skip
    driven = DrivenMotion(time, front, speed, np.zeros(101), {"stops": stops})
    for stops_of_law, arrivals in ((stops, [40.0, 80.0, 10.0]), (stops[1:2], [40.0])):
        law = replace(driven, metrics={"stops": stops_of_law})
        found = motion_difference(law, replace(driven, metrics={}, measured=True)).stops
        assert [row["second_arrival_s"] for row in found] == arrivals
    assert found[0]["difference_stop_m"] == 0.0 and found[0]["difference_arrival_s"] == -1.0


def test_the_difference_of_two_runs_has_the_posts_of_the_line() -> None:
    """At 10 m/s to 100 m, where the post is 2+900: breaks if stops and the largest difference have distances only."""
    on = Line.model_validate(
        {"schema": "train_ato/line/1", "name": "p", "chainage": [{"begin": "3+000", "end": "2+000"}]}
    )
    stop = {"km": 0.1, "planned_s": 10.0, "arrival_s": 10.0, "delay_s": 0.0, "beyond_m": 0.0}
    time = np.arange(11.0)
    first = DrivenMotion(time, 10.0 * time, np.full(11, 36.0), np.zeros(11), {"stops": [stop]}, on=on)
    found = motion_difference(first, replace(first, speed=np.where(time < 5, 36.0, 37.0)))
    assert found.posts == ["2+900"] and "at km 2+950; time" in found.line


@pytest.mark.usefixtures("without_figure")
def test_a_stop_that_one_run_does_not_reach_has_no_difference(tmp_path: Path, capsys) -> None:
    """Breaks if a stop without arrival is left out or gets a number, or the page of both runs lacks the difference."""
    hop = {"phases": [{"accelerate_to": 5.0, "acceleration": 0.5}, {"cruise_for": 5}, {"brake_to": 0.0}]}
    first = ta.scenario("xuzhou_metro").with_({"profile": hop, "duration": 40, "plant.start": {}})
    whole = ta.run(first, out=tmp_path / "whole")
    (stop,) = whole.result.stops
    assert stop.arrival_s is not None and stop.beyond_m is not None
    for duration in (20, 23.1):  # the planned arrival is at 23.7 s
        cut = ta.run(first, set={"duration": duration}, out=tmp_path / f"cut{duration:.0f}")
        for found, arrival in (
            (ta.difference(whole, cut), "arrival_s"),
            (ta.difference(cut, whole), "second_arrival_s"),
        ):
            (row,) = found.stops.to_dict("records")
            assert (row.pop("km"), row.pop(arrival)) == (stop.km, stop.arrival_s)
            assert len(row) == 3 and np.isnan(list(row.values())).all()
    line = ta.difference(whole, cut).line
    assert main(["report", str(tmp_path / "whole"), str(tmp_path / "cut23"), "--out", str(tmp_path / "c.html")]) == 0
    assert capsys.readouterr().out.startswith(f"cut23 against whole: {line}\n")
    page = (tmp_path / "c.html").read_text()
    assert "Difference from whole" in page and line in page
    assert "time difference in s" in page and "difference of places in m" in page
