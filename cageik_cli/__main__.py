"""`python -m cageik_cli` is `cageik`."""

from cageik_cli.cli import main

if __name__ == "__main__":
    main()
