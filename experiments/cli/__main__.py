"""`python -m experiments.cli` is `jaxsphere`."""

import sys

from experiments.cli.entry import main

sys.exit(main())
