"""``python -m sysid``: the same as ``thinshell``."""

import sys

from sysid.cli.app import main

sys.exit(main())
