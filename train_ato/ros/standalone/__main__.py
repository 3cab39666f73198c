"""``python -m train_ato.ros.standalone NODE ...``: one node in a separate process."""

import sys

from train_ato.messages.topics import Role
from train_ato.program.arguments import OneLineParser
from train_ato.ros.standalone.entry import run_role

parser = OneLineParser(prog="python -m train_ato.ros.standalone", description="One node; see `NODE --help`.")
parser.add_argument("node", choices=[role.value for role in Role], metavar="NODE")
sys.exit(run_role(Role(parser.parse_args(sys.argv[1:2]).node), sys.argv[2:]))
