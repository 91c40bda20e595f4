"""Has rerun load each file of a recording, as its viewer would, and looks for what must have come out of it.

    read_with_rerun.py BAG TOPIC...

`rerun mcap check` must find no problem; the converted recording must hold an entity for every TOPIC.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

RERUN = Path(sys.executable).with_name("rerun")


def run(*arguments):
    done = subprocess.run([RERUN, *arguments], capture_output=True, text=True, timeout=120, check=False)
    text = done.stdout + done.stderr
    assert done.returncode == 0, f"rerun {' '.join(map(str, arguments))}: exit {done.returncode}\n{text}"
    return text


def main(bag, *topics):
    files = sorted(Path(bag).glob("*.mcap"))
    assert files, f"{bag}: no .mcap file"
    with tempfile.TemporaryDirectory() as folder:
        for file in files:
            print(run("mcap", "check", file))
            converted = Path(folder) / f"{file.stem}.rrd"
            run("mcap", "convert", file, "--output", converted)
            printed = run("rrd", "print", "-vv", converted)
            missing = [topic for topic in topics if topic not in printed]
            assert not missing, f"{file}: rerun made nothing of {missing}\n{printed}"
    print(f"rerun loads {bag}: {', '.join(topics)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
