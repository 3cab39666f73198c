"""Console scripts of the standalone nodes ``plant_node``, ``profile_node`` ... for ``ros2 run train_ato NODE``."""

import sys
from functools import partial

from train_ato.messages.topics import Role
from train_ato.ros.standalone.entry import run_role


def _run(role: Role) -> int:
    """Run a node with the command line of this process."""
    return run_role(role, sys.argv[1:])


plant, profile, supervisor = (partial(_run, role) for role in (Role.PLANT, Role.PROFILE, Role.SUPERVISOR))
observer, controller = (partial(_run, role) for role in (Role.OBSERVER, Role.CONTROLLER))


def recorder() -> int:
    """Run the recorder node; it writes the figure of the run to its folder."""
    from train_ato.report.print_figures import write_run_figure  # matplotlib: not needed before the end

    return run_role(Role.RECORDER, sys.argv[1:], completed=write_run_figure)


if __name__ == "__main__":  # python -m train_ato.cli.nodes ROLE ...
    sys.exit(globals()[Role(sys.argv.pop(1)).value]())
