"""``python -m train_ato.ros.standalone ROLE ...``: one node in a separate process."""

import sys

from train_ato.messages.topics import Role
from train_ato.ros.standalone.entry import run_role

sys.exit(run_role(Role(sys.argv[1]), sys.argv[2:]))
