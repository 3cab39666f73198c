"""A recorded run replayed: its messages published again, or a law evaluated on its inputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from train_ato.api.progress import progress_bar
from train_ato.api.scenario_choice import Changes, ScenarioChoice, choose_component, given_objects, put_components
from train_ato.control.registry import LAWS
from train_ato.log.run_folder import read_run_folder
from train_ato.program.arguments import check_new_file
from train_ato.program.errors import check_kinds
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    from train_ato.playback.open_loop import OpenLoop
    from train_ato.playback.publishing import Replayed

FORMATS = (".png", ".svg", ".pdf")


@overload
def replay(run: str | Path, law: None = None, *, domain: int | None = None, **publishing: Any) -> Replayed: ...


@overload
def replay(
    run: str | Path, law: Any, *, set: Changes | None = None, out: str | Path | None = None
) -> OpenLoop: ...  # fmt: skip


def replay(
    run: str | Path,
    law: Any = None,
    *,
    set: Changes | None = None,
    out: str | Path | None = None,
    domain: int | None = None,
    **publishing: Any,
) -> OpenLoop | Replayed:
    """Evaluate a law on the recorded inputs of a run, or publish its messages again, as ``train-ato replay`` does.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    law
        Law to evaluate, in the forms of :func:`train_ato.run`; default: none, the messages are published.
    set
        Other keys of the scenario for the law; train, sensors and tick are those of the recording.
    out
        New figure of both outputs (.png, .svg, .pdf); default: none.
    domain
        ROS domain of the published messages; default: as in the environment.
    **publishing
        Attributes of :class:`~train_ato.playback.log.ReplayOptions`, as ``rate=5``.

    Returns
    -------
    OpenLoop or Replayed
        Outputs in the log and of the law; without a law, numbers of messages by topic.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy.
    RunFailed
        After Ctrl-C.

    Examples
    --------
    >>> import train_ato as ta
    >>> run = ta.run("demo", set={"duration": 5})
    >>> found = ta.replay(run.folder(), "pid")
    >>> found.summary()["ticks"], found.summary()["equal_ticks"]
    (50, 50)
    """
    path = Path(run)
    if law is None:
        if set or out:
            raise ValueError(f"{'set' if set else 'out'}: only for the evaluation of a law; add law")
        from train_ato.playback.log import ReplayOptions
        from train_ato.playback.publishing import publish_run

        known = [field.name for field in dataclasses.fields(ReplayOptions)]
        for name in publishing:
            if name not in known:
                raise ValueError(f"{name}: unknown; use one of {', '.join(known)}")
        for name in ("topics", "exclude"):  # the name of one topic is a list of it, not of its characters
            if isinstance(publishing.get(name), str):
                publishing[name] = (publishing[name],)
        check_kinds(ReplayOptions.__annotations__, publishing)
        return publish_run(path, ReplayOptions(**publishing), domain=domain)
    if publishing or domain is not None:
        raise ValueError(f"{next(iter(publishing), 'domain')}: no effect with law, which does not publish; remove it")
    if out is not None:
        check_new_file(Path(out), FORMATS, "out")
    recorded, summary = read_run_folder(path)
    choose_component(LAWS, law).refuse_changes(set)
    changed = setup_with_law(recorded, path, law, lambda choice: choice.changed(set, None), "set")
    return evaluated(recorded, changed, path, summary, None if out is None else Path(out))


def setup_with_law(
    recorded: RunSetup, run: Path, law: Any, change: Callable[[ScenarioChoice], ScenarioChoice], option: str = "--set"
) -> RunSetup:
    """Return the setup of a recorded run with another law and changed keys; its own law keeps its planned changes."""
    import yaml

    data: dict[str, Any] = yaml.safe_load(recorded.resolved_yaml())
    choice = change(ScenarioChoice(data, run, data))
    scenario = put_components(choice.checked, law=law, importable=False)
    if scenario.law != recorded.scenario.law:
        scenario = scenario.model_copy(update={"law_changes": ()})
    changed = dataclasses.replace(choice.prepare(scenario, recorded=True), given=given_objects(scenario, law=law))
    if changed.layout != recorded.layout or changed.tick_ns != recorded.tick_ns:
        raise ValueError(f"{option}: train, sensors and tick of a recording are fixed; change other keys")
    return changed


def evaluated(
    recorded: RunSetup, changed: RunSetup, run: Path, summary: dict[str, Any], figure: Path | None
) -> OpenLoop:
    """Return the outputs of a law on the recorded inputs of a run, and draw them."""
    from train_ato.playback.open_loop import replay_open_loop

    law = changed.scenario.law
    with progress_bar(f"{law} on the inputs of {run.name}") as progress:
        result = replay_open_loop(changed, run, progress)
    if figure is not None:
        from train_ato.playback.open_loop import draw_open_loop

        title = f"{recorded.scenario.name}: {law} on the recorded inputs, open loop"
        draw_open_loop(result, title, *output_names(recorded, summary, law), figure)
    return result


def output_names(recorded: RunSetup, summary: dict[str, Any], law: str) -> tuple[str, str]:
    """Return the labels of the recorded output (its laws, or the measured quantity) and of the replayed one.

    The law of the run is replayed with its changes, but keeps its state where that of the run was restarted.
    """
    from train_ato.api.import_csv.run import MEASURED, NOT_RECORDED
    from train_ato.report.words import driven_laws

    driven = {"controller": recorded.scenario.law, **summary}
    laws = driven_laws(driven)
    if summary.get("controller") != MEASURED:
        name = f"{laws}, recorded{' with a restart' if 'controller' in summary.get('restarts', {}) else ''}"
    else:
        at_wheel = summary.get("measured_command") == NOT_RECORDED
        name = "force at the wheel, measured" if at_wheel else "demand, measured"
    return name, f"{laws if law == driven['controller'] else law}, replayed"
