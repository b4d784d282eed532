"""`python -m tepm_opt`: the command line."""

from tepm_opt.cli import main

main()
