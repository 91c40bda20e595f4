"""Has rerun load each file of a recording, as its viewer would, and looks for what must have come out of it.

    read_with_rerun.py BAG TOPIC...

`rerun mcap check` must find no problem; the converted recording must hold an entity for every TOPIC, images and a
camera among them.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

RERUN = Path(sys.executable).with_name("rerun")


def run(home, *arguments):
    environment = {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home}
    done = subprocess.run(
        [RERUN, *arguments], capture_output=True, text=True, timeout=120, check=False, env=environment
    )
    text = done.stdout + done.stderr
    assert done.returncode == 0, f"rerun {' '.join(map(str, arguments))}: exit {done.returncode}\n{text}"
    return text


def main(bag, *topics):
    files = sorted(Path(bag).glob("*.mcap"))
    assert files, f"{bag}: no .mcap file"
    with tempfile.TemporaryDirectory() as folder:
        run(folder, "analytics", "disable")
        for file in files:
            print(run(folder, "mcap", "check", file))
            converted = Path(folder) / f"{file.stem}.rrd"
            run(folder, "mcap", "convert", file, "--output", converted)
            printed = run(folder, "rrd", "print", "-vv", converted)
            # As images and cameras, not as bytes that it does not understand.
            wanted = [*topics, "archetype: EncodedImage", "archetype: Pinhole"]
            missing = [text for text in wanted if text not in printed]
            assert not missing, f"{file}: rerun made nothing of {missing}\n{printed}"
    print(f"rerun loads {bag}: {', '.join(topics)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
