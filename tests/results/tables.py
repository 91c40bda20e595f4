"""Measures the tables of docs/results and writes them there, each with its commands, commit, engine and machine:

    python3 tests/results/tables.py [--data ../shared/data] [--out out/results] [TABLE ...]

TABLE is one of those below (default: all; three hours on two cores). Builds what it runs. What is in --out from an earlier run of the
same code, settings and engine is not measured again, so a run that was interrupted goes on. Needs BOP folders as
../shared/data/README.md describes them, tests/requirements.txt for `finding` and ffmpeg for `camera_rate`; ONNX Runtime where
ORT_DYLIB_PATH names it, else the engine inside the binary. Nothing else should run beside it: the pages hold times.
"""

import argparse
import hashlib
import os
import shlex
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import rates  # noqa: E402
import refinement  # noqa: E402
from refinement import ROOT  # noqa: E402

# What a result depends on.
SOURCES = ["nodes", "msgs", "config", "bags", "Cargo.toml", "Cargo.lock"]
ENGINE = "ONNX Runtime" if os.environ.get("ORT_DYLIB_PATH") else "the engine inside the binary"
TABLES = {
    "refinement": refinement.refinement,
    "true_start": refinement.true_start,
    "finding": refinement.finding,
    "tracking": rates.tracking,
    "camera_rate": rates.camera_rate,
    "adaptation": refinement.adaptation,
}


def output(*command):
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def machine():
    model = next(line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name"))
    wide = "AVX-512" if " avx512f" in Path("/proc/cpuinfo").read_text() else "AVX2"
    return f"{os.cpu_count()} cores of {model}, {wide}"


class Run:
    """Runs programs of this repository once and remembers them for the page."""

    def __init__(self, arguments):
        self.data, self.out = arguments.data.resolve(), arguments.out.resolve()
        target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
        self.programs = {"pseudoflow": target / "pseudoflow", "track_sequence": target / "examples/track_sequence"}
        self.commands = []

    def once(self, made, program, *arguments):
        """Runs PROGRAM unless the file or folder MADE is there; the words of the command go onto the page."""
        words = [str(word) for word in arguments]
        self.commands.append(self.shown(program, words))
        if not made.exists():
            log = made.with_suffix(".log")
            log.parent.mkdir(parents=True, exist_ok=True)
            print(self.commands[-1], flush=True)
            with log.open("w") as file:
                code = subprocess.run([self.programs[program], *words], cwd=ROOT, stdout=file, stderr=subprocess.STDOUT).returncode
            # 3: `adapt` says that what it trained is not better.
            if code not in (0, 3) or not made.exists():
                raise SystemExit(f"exit code {code}: {self.commands[-1]}\n{log} says why")
        return made

    def shown(self, program, words):
        """The command as a reader would type it."""
        text = shlex.join([program, *words])
        for path, name in ((self.out, "out"), (self.data, "data"), (ROOT, ".")):
            text = text.replace(str(path), name)
        return text.replace(" ./", " ")


def page(name, run, body):
    commands = "\n".join(dict.fromkeys(run.commands))
    text = (
        f"<!-- Written by tests/results/tables.py {name}: do not edit. -->\n{body}\n"
        f"Commit {output('git', 'rev-parse', '--short', 'HEAD')}, {machine()}, {ENGINE}, one run unless it says otherwise.\n\n"
        f"<!-- parsed: data that is not in this repository, and hours -->\n```sh\n{commands}\n```\n"
    )
    path = ROOT / "docs/results" / f"{name}.md"
    path.write_text(text)
    print(f"wrote {path}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared/data")
    parser.add_argument("--out", type=Path, default=ROOT / "out/results")
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=", ".join(TABLES))
    arguments = parser.parse_args()
    if unknown := set(arguments.tables) - set(TABLES):
        parser.error(f"no table {', '.join(sorted(unknown))}: there are {', '.join(TABLES)}")
    if changed := output("git", "status", "--porcelain", *SOURCES):
        parser.error(f"a table names the commit that it is of, and this is not committed:\n{changed}")
    subprocess.run(["cargo", "build", "--release", "--workspace", "--bins", "--example", "track_sequence"], cwd=ROOT, check=True)
    measured = output("git", "ls-tree", "HEAD", *SOURCES) + ENGINE
    arguments.out = arguments.out / hashlib.sha256(measured.encode()).hexdigest()[:10]
    for name in arguments.tables or TABLES:
        run = Run(arguments)
        page(name, run, TABLES[name](run))


if __name__ == "__main__":
    main()
