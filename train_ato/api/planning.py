"""Speed profile of a train on a line, planned from names or files."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plant_sim.formats.fields import print_assumption
from plant_sim.input_error import explain
from plant_sim.library import load_line
from plant_sim.line import line_for
from plant_sim.si_model import unusual_values
from train_ato.profile.file import write_profile
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings, find_train
from train_ato.profile.planner.timing_points import read_journey
from train_ato.program.arguments import OPTIONS_OF_PLAN, check_new_file

PROFILES, FIGURES = (".csv", ".yaml", ".yml"), (".png", ".pdf", ".svg")
OF_THE_JOURNEY = ("time", "allowance", "begin", "end", "dwell", "calling")
"""Settings that timing points have."""


def plan(
    line: str | Path,
    train: str | Path,
    *,
    journey: str | Path | None = None,
    period: float = 0.1,
    out: str | Path | Sequence[str | Path] = (),
    **settings: Any,
) -> Plan:
    """Plan a speed profile, as ``train-ato plan`` does.

    Parameters
    ----------
    line, train
        Shipped name or file, in any format of ``train-ato convert``.
    journey
        File of timing points with windows; it replaces ``time``, ``allowance``, ``begin``, ``end``,
        ``dwell`` and ``calling``.
    period
        Time between the knots of the profile [s].
    out
        New files: profile (.csv, .yaml) or figure (.png, .pdf, .svg).
    **settings
        Keys of :class:`~train_ato.profile.planner.settings.PlanSettings` [SI], or with the suffixes of the data files:
        ``time=120``, ``end_km=2``, ``jerk=None``. ``begin`` and ``end`` can be a post: ``"84+500"``.

    Returns
    -------
    Plan
        Profile, stops, energy; ``summary()`` has the figures of the command.

    Raises
    ------
    ValueError
        Bad input, one line for each fault; nothing was computed.

    Examples
    --------
    >>> import train_ato as ta
    >>> found = ta.plan("xuzhou_metro_test", "xuzhou_metro_3", end_km=2)
    >>> found.summary()["stops"][-1]["place_m"]
    2000.0
    """
    files = [Path(out)] if isinstance(out, (str, Path)) else [Path(path) for path in out]
    for path in files:
        check_new_file(path, (*PROFILES, *FIGURES))
    if not 1e-3 <= period <= 10:
        raise ValueError(f"period {period:g}: out of range; give 0.001 to 10 s")
    suffixed = PlanSettings.suffixed_keys()
    named = {suffixed[key][0] if key in suffixed else key for key in settings}
    if journey is not None and (twice := sorted(named & {*OF_THE_JOURNEY})):
        raise ValueError(f"{', '.join(twice)} with journey: the timing points have it; remove it")
    on = load_line(str(line))
    consist, usual = find_train(str(train), point_mass=bool(settings.get("point_mass", False)))
    on = line_for(on, consist.categories, consist.rating)
    data = {key: value for key, value in usual.model_dump().items() if key not in named}
    posts = {key: value for key, value in settings.items() if key in ("begin", "end") and isinstance(value, str)}
    for key, post in posts.items():
        try:
            settings[key] = on.place_of(post)
        except ValueError as error:
            raise ValueError(f"{OPTIONS_OF_PLAN}: {key} = {error}") from None
    try:
        chosen = PlanSettings.model_validate({**data, **settings})
    except ValidationError as error:
        raise explain(error, OPTIONS_OF_PLAN, PlanSettings, settings) from None
    for text in unusual_values(chosen):
        if re.split(r"[ .\[]", text)[0] in named:  # those of the train have their note
            print_assumption(f"{text}; check its unit")
    if journey is not None:
        chosen = chosen.model_copy(update={"points": read_journey(str(journey), on).points})
    result = plan_profile(on, consist, chosen, period)
    for path in files:
        if path.suffix.lower() in FIGURES:
            from train_ato.report.plan_figure import draw_plan

            draw_plan(result, path)
        else:
            chosen = result.settings
            source = f"train-ato plan {line} {train}: {result.running_time:.2f} s, force margin {chosen.force_margin:g}"
            write_profile(result.profile, path, f"{source}, jerk {chosen.jerk} m/s3")
    return result
