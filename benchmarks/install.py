"""Makes the environment of the peers, with as many of them as this machine has packages for.

    python -m benchmarks.install .venv-bench

They have an environment of their own because they may want other versions of NumPy and llvmlite than Ebb. Their list is
the extra ``bench``.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> None:
    folder = Path(sys.argv[1])
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    with (ROOT / "pyproject.toml").open("rb") as file:
        peers = tomllib.load(file)["project"]["optional-dependencies"]["bench"]
    command = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if subprocess.run([*command, *peers]).returncode == 0:
        return
    for peer in peers:  # not together: then as many as can be had
        if subprocess.run([*command, peer]).returncode != 0:
            print(f"{peer} cannot be installed here; the benchmarks leave it out", file=sys.stderr)


if __name__ == "__main__":
    main()
