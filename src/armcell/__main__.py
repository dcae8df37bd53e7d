"""`python -m armcell`."""

from armcell.cli.main import main

main()
