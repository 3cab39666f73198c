"""Node ``plant`` as an entry point; the node itself is :mod:`plant_sim.node`."""

from __future__ import annotations

import sys

from train_ato.nodes.process import run_role
from train_ato.topics import Role


def main() -> int:
    """Run this node alone in a process."""
    return run_role(Role.PLANT)


if __name__ == "__main__":
    sys.exit(main())
