"""`python -m grasp_refine_apps` runs the console script."""

import sys

from grasp_refine_apps.cli import main

sys.exit(main())
