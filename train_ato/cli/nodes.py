"""Console scripts of the standalone nodes ``plant_node``, ``profile_node`` ... for ``ros2 run train_ato NODE``."""

import sys

from train_ato.messages.topics import Role
from train_ato.ros.standalone.entry import run_role


def plant() -> int:
    """Run the plant node."""
    return run_role(Role.PLANT, sys.argv[1:])


def profile() -> int:
    """Run the profile node."""
    return run_role(Role.PROFILE, sys.argv[1:])


def supervisor() -> int:
    """Run the supervisor node."""
    return run_role(Role.SUPERVISOR, sys.argv[1:])


def observer() -> int:
    """Run the observer node."""
    return run_role(Role.OBSERVER, sys.argv[1:])


def controller() -> int:
    """Run the controller node."""
    return run_role(Role.CONTROLLER, sys.argv[1:])


def recorder() -> int:
    """Run the recorder node; it writes the figure of the run to its folder."""
    from train_ato.report.print_figures import write_run_figure  # matplotlib: not needed before the end

    return run_role(Role.RECORDER, sys.argv[1:], completed=write_run_figure)


if __name__ == "__main__":  # python -m train_ato.cli.nodes ROLE ...
    sys.exit(globals()[Role(sys.argv.pop(1)).value]())
