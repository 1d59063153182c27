"""Run every benchmark but the soak, one process each, and keep what they print.

    python benchmarks/run_all.py [--only b0 b2]

The JSON lines of each go into `results/<script>.jsonl`, pictures beside them. Three
quarters of an hour on two quiet cores.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from measure import RESULTS
from scenes import SCENES

HERE = Path(__file__).parent
ARGUMENTS = {"b0_work_precision": ["--scenes", *SCENES]}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", default=[""], help="beginnings of names")
    only = tuple(parser.parse_args().only)
    RESULTS.mkdir(exist_ok=True)
    failed = []
    for script in sorted(HERE.glob("[abcs][0-9]*_*.py")):
        if not script.name.startswith(only):
            continue
        print(f"== {script.name}", flush=True)
        command = [sys.executable, str(script), *ARGUMENTS.get(script.stem, [])]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
        print(done.stdout, end="", flush=True)
        (RESULTS / f"{script.stem}.jsonl").write_text(done.stdout)
        if done.returncode:
            failed.append(script.name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
