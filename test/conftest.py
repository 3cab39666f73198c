"""Fixtures for all tests: signals, data of open projects, a ROS domain, one hypothesis profile; marks by cost."""

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import open_data as tables
import pytest
from hypothesis import HealthCheck, Phase, settings

pytest_plugins = ("case_costs",)
OF_MOTION = "brake_policies, couplers, following, gains, law_mpc, law_mpc_lines, own_trains, random_runs"
"""Files about laws, brakes and trains."""
HERE = Path(__file__).resolve().parent
MODULES = filter(None, (str(HERE.parent), str(HERE), os.environ.get("PYTHONPATH")))
os.environ["PYTHONPATH"] = os.pathsep.join(MODULES)  # for the programs that the tests start
sys.dont_write_bytecode = False  # every worker and program would compile every source again
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.pop("FORCE_COLOR", None)  # printed lines and bars would have escape sequences
settings.register_profile(
    "train_ato", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("first_failure", settings.get_profile("train_ato"), phases=[Phase.explicit, Phase.generate])
settings.load_profile("train_ato")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage in the modules and cases of a collection, now and in the tests: they stay to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000, 10, 10)
        gc.enable()


def pytest_sessionfinish() -> None:
    """Look for garbage once at the end; pytest does so five times."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def signals_of_a_terminal() -> Iterator[None]:
    """Handle signals as in a terminal; a shell ignores them in its background, which child processes inherit."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module", autouse=True)
def compiled_ticks(request: pytest.FixtureRequest) -> Iterator[None]:
    """Use compiled ticks from short runs on in the files of motion: the same steps and numbers in less time."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.stem.removeprefix("test_") in OF_MOTION.split(", "):
            patch.setattr("train_ato.loop.engine.COMPILED_FROM", 300)
        yield


@pytest.fixture(scope="session")
def open_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the trains and lines of open projects into a folder."""
    folder = tmp_path_factory.mktemp("open_data")
    tables.write(folder)
    return folder


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return the function that gives the folder of a recorded run of the demo with changes, equal ones once."""

    @cache
    def recorded(*changes: str) -> Path:
        from engine_runs import record_run, setup_of

        return record_run(setup_of("demo", *changes), tmp_path_factory.mktemp("demo") / "run")

    return recorded


@pytest.fixture
def domain() -> Iterator[int]:
    """Lock a ROS domain."""
    from train_ato.ros.graph.environment import claim_domain

    with claim_domain() as held:
        yield held


@pytest.fixture
def without_figure() -> Iterator[None]:
    """Leave out ``figure.png`` in the runs of a test."""
    from engine_runs import no_figure

    with no_figure():
        yield
