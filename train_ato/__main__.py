"""``python -m train_ato``: the command line."""

import sys

from train_ato.cli.main import main

sys.exit(main())
