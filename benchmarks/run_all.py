"""Run every benchmark but the soak, one process each, and keep what they print.

    python benchmarks/run_all.py [--only b0 b2]

The JSON lines of each go into `results/<script>.jsonl`; scripts that draw write
`results/*.json` and pictures themselves. About an hour on two quiet cores.
"""

import subprocess
import sys
from pathlib import Path

from measure import RESULTS, arguments
from scenes import SCENES

# these write results of their own
WRITE = ("b0_work_precision", "c0_extreme", "c1_honesty")
# how a script is called, one list a call, where that is not once as it is
CALLS = {
    "a5_certificates": [
        ["--seed", "13"],
        ["--seed", "14", "--cells", "14000", "--beside", "1500", "--again", "0"],
        ["--law", "dry", "--cells", "6600", "--seed", "29", "--beside", "0"],
    ],
    "a13_certified_truth": [
        ["share", "onsets"],
        ["kicks", "--columns", "205", "--seed", "2"],
        ["kinds", "--seed", "2911"],
    ],
    "b0_work_precision": [["--scenes", *SCENES]],
    "b3_questions": [
        [],
        ["--cells", "0", "--repeats", "2", "--only", "certified", "dry"],
    ],
}


def main():
    only = tuple(arguments(__doc__, only=("",)).only)  # beginnings of names
    RESULTS.mkdir(exist_ok=True)
    failed = []
    for script in sorted(Path(__file__).parent.glob("[abc][0-9]*_*.py")):
        if not script.name.startswith(only):
            continue
        print(f"== {script.name}", flush=True)
        lines = ""
        for options in CALLS.get(script.stem, [[]]):
            command = [sys.executable, str(script), *options]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
            print(done.stdout, end="", flush=True)
            lines += done.stdout
            if done.returncode:
                failed.append(" ".join([script.name, *options]))
        if script.stem not in WRITE:
            (RESULTS / f"{script.stem}.jsonl").write_text(lines)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
