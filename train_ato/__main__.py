"""``python -m train_ato``: the command line."""

import sys

try:
    from train_ato.cli.main import main
except KeyboardInterrupt:
    sys.exit("train-ato: interrupted")

sys.exit(main())
