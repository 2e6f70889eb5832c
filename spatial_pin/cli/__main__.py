"""`python -m spatial_pin.cli` is the command `spatial-pin`."""

from spatial_pin.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
