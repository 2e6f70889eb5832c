# Sourced by the scripts beside it: makes .venv with the library and the extras named in $1.
# A second call with nothing changed takes no time; changed C files are compiled by it.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python_new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

if [ ! -x .venv/bin/python ]; then
  python=""
  for candidate in "${PYTHON:-python3}" python3.14 python3.13 python3.12 python3.11; do
    if python_new_enough "$candidate"; then python=$candidate; break; fi
  done
  if [ -z "$python" ]; then
    echo "spatial_pin needs Python 3.11 or newer; set PYTHON to one, or install it" >&2
    exit 1
  fi
  if ! "$python" -m venv .venv; then
    rm -rf .venv
    echo "$python cannot make a virtual environment (on Debian: apt install python3-venv)" >&2
    exit 1
  fi
fi

what_is_installed() { cat pyproject.toml scripts/build_kernel.py spatial_pin/kernel/*/*.[ch]; }

stamp=.venv/installed-$1
if ! ls spatial_pin/kernel/_kernel.* >/dev/null 2>&1 || ! what_is_installed | cmp -s - "$stamp"; then
  echo "installing into .venv ..." >&2
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".${1:+[$1]}"
  what_is_installed > "$stamp"
fi
