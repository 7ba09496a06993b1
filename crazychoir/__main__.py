"""`python -m crazychoir` is the command `crazychoir`."""

from crazychoir.cli.main import main

if __name__ == "__main__":
    main()
