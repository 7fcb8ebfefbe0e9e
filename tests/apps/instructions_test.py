#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A slowdown seen without a clock: how many instructions six commands execute, start-up included, on a
small capture of the virtual rig, counted by valgrind. Each count must stay within 5 % of the one in
instructions.txt. instructions_test.py BIN, the build's folder apps/; with --store it writes that file.

Counts mean something only beside the same compiler and libraries, which stand in the same file, and on
processors with AVX2, the widest vectors that valgrind knows. Elsewhere the test is skipped (77) and says
why. Runs of one machine differ by less than 0.1 %, though the noise in their pictures differs; one
processor instead of two changed a count by 0.4 % at most."""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

from programs import SOURCE, Programs, VirtualRig, free_port, rig_on_free_ports

STORED = pathlib.Path(__file__).resolve().parent / "instructions.txt"
MOST = 0.05
SKIPPED = 77
VECTORS = {"avx2", "bmi2", "f16c", "fma"}
# Those that take more than about a hundredth of a count, or are compiled into us.
PACKAGES = ["libc6", "libeigen3-dev", "libembree3-3", "libpng16-16", "libsqlite3-0", "libstdc++6",
            "libtbb12", "libtiff6", "libxxhash0", "libzstd1", "nlohmann-json3-dev", "valgrind", "zlib1g"]
SKY = SOURCE / "configs/environments/room.hdr"
SHADOW = ["shadow", "object.hlb", "--scene", SOURCE / "configs/scenes/stairs.toml", "--object-height",
          "76,128", "--light", "27", "--size", "160x120"]
COMMANDS = {
    "compress": ["compress", "session", "-o", "object.hlb"],
    "relight-light": ["relight", "object.hlb", "--light", "27", "-o", "light.png"],
    "relight-sky": ["relight", "object.hlb", "--cubemap", SKY, "-o", "sky.png"],
    "relight-frames": ["relight", "object.hlb", "--cubemap", SKY, "--frames", "4", "-o", "turn.png"],
    "shadow-light": [*SHADOW, "-o", "shadow.png"],
    "develop": ["develop", "session", "--force"],
}


def versions(programs):
    """Of all that a count depends on and that is not ours: a line each."""
    cache = (programs.bin.parent / "CMakeCache.txt").read_text()

    def kept(key):
        found = re.search(rf"(?m)^{key}:\w+=(.*)$", cache)
        return found[1] if found else ""

    compiler = subprocess.run([kept("CMAKE_CXX_COMPILER"), "--version"], capture_output=True, text=True,
                              check=True).stdout.splitlines()[0]
    lines = {"compiler": compiler.split(" ", 1)[-1],  # without the name that it was called by
             "build": " ".join([kept("CMAKE_BUILD_TYPE"), kept("CMAKE_CXX_FLAGS"),
                                kept("CMAKE_CXX_FLAGS_RELEASE")])}
    for package in PACKAGES:
        asked = subprocess.run(["dpkg-query", "-W", "-f=${Version} ", package], capture_output=True, text=True,
                               check=False)
        lines[package] = asked.stdout.strip() or "missing"
    return lines


def read_stored(text):
    """@return  versions and counts, both by name"""
    found = {"version": {}, "count": {}}
    for line in text.splitlines():
        if line and not line.startswith("#"):
            kind, name, value = line.split(maxsplit=2)
            found[kind][name] = int(value) if kind == "count" else value
    return found["version"], found["count"]


def text_of(found, counts):
    return "\n".join(["# Instructions of each command; versions that they hold for. Written by",
                      "# tests/apps/instructions_test.py build/release/apps --store",
                      *(f"version {name} {value}" for name, value in found.items()),
                      *(f"count {name} {value}" for name, value in counts.items())]) + "\n"


def reason_to_skip(stored, found, flags):
    """Why this machine's counts cannot be compared; nothing where they can."""
    if shutil.which("valgrind") is None:
        return "valgrind is not installed: scripts/install_packages check"
    if not VECTORS <= flags:
        return f"this processor lacks {', '.join(sorted(VECTORS - flags))}: other code runs"
    other = [f"{name} is {found.get(name, 'missing')}, not {value}" for name, value in stored.items()
             if found.get(name) != value]
    other += [f"{name} has no stored version" for name in found if name not in stored]
    return f"counts were stored with other versions: {'; '.join(other)}" if other else ""


def miss(name, stored, count, profile):
    """What is wrong with a count; nothing where it is near the stored one."""
    if stored is None:
        return f"{name}: no stored count, found {count}; store it: {store_command()}"
    if abs(count - stored) <= MOST * stored:
        return ""
    word = "more" if count > stored else "fewer"
    return (f"{name}: {count} instructions, {count / stored:.3f} times the stored {stored}: {word} by over "
            f"{MOST:.0%}\n"
            f"  find the cause: callgrind_annotate {profile} | head -n 40 (and the same before the change)\n"
            f"  if it is meant, store the new counts: {store_command()}")


def store_command():
    return f"python3 tests/apps/instructions_test.py {sys.argv[1]} --store"


def test_the_comparison():
    """It can fail, both ways, and says by how much; and it is skipped for other machines only."""
    assert miss("a", 100000, 104999, "p") == "" and miss("a", 100000, 95001, "p") == ""
    assert "1.051 times the stored 100000" in miss("a", 100000, 105100, "p")
    assert "0.949 times" in miss("a", 100000, 94900, "p") and "--store" in miss("a", 100000, 94900, "p")
    assert "no stored count" in miss("a", None, 5, "p")
    kept = {"libc6": "2.36", "build": "Release  -O3 -DNDEBUG"}
    assert read_stored(text_of(kept, {"a": 7})) == (kept, {"a": 7})
    if shutil.which("valgrind"):
        assert reason_to_skip(kept, kept, VECTORS) == ""
        assert "libc6 is 2.37, not 2.36" in reason_to_skip(kept, {**kept, "libc6": "2.37"}, VECTORS)
        assert "zlib1g has no stored" in reason_to_skip(kept, {**kept, "zlib1g": "1"}, VECTORS)
        assert "lacks avx2" in reason_to_skip(kept, kept, VECTORS - {"avx2"})


def capture(programs, folder):
    """folder/session: 64 lights, 320 x 240 pixels of the airplane."""
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    rig_on_free_ports(SOURCE / "configs/rigs/small8.toml", folder / "rig.toml", folder, port,
                      [("size", "[320, 248]"), ("active_area", "240"), ("fps", "60.0"),
                       ("exposure_us", "8000.0"),
                       ("K", "[[439.6, 0.0, 160.0], [0.0, 439.6, 120.0], [0.0, 0.0, 1.0]]")])
    rig = VirtualRig(programs, folder / "rig.toml", SOURCE / "configs/scenes/airplane.toml", folder, url)
    try:
        done = programs.run("capture", SOURCE / "configs/plans/quick.toml", "--daemon", url, "--quiet",
                            timeout=300)
        assert done.returncode == 0, done.stderr
    finally:
        rig.end()
    pathlib.Path(done.stdout.strip()).rename(folder / "session")


def instructions(programs, words, folder, profile):
    """Of one run on one thread, in an environment of its own."""
    done = subprocess.run(["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}",
                           programs.haarlight, *words, "--threads", "1", "--quiet"],
                          cwd=folder, capture_output=True, text=True, timeout=500, check=False,
                          env={"PATH": "/usr/bin:/bin", "HOME": str(folder), "LC_ALL": "C",
                               "HAARLIGHT_KERNELS": "avx2"})  # else it is measured which one runs
    found = re.search(r"Collected : (\d+)", done.stderr)
    assert done.returncode == 0 and found, f"{words[0]} returned {done.returncode}\n{done.stderr}"
    return int(found[1])


def measure(programs):
    """Every command's count; its profile is kept beside the programs, in ../instructions."""
    profiles = programs.bin.parent / "instructions"
    profiles.mkdir(exist_ok=True)
    counts = {}
    with tempfile.TemporaryDirectory(prefix="haarlight-instructions.") as place:
        folder = pathlib.Path(place)
        capture(programs, folder)
        for name, words in COMMANDS.items():
            if name == "shadow-light":  # The first one carves the hull, and keeps it.
                done = programs.run(*SHADOW, "-o", "first.png", "--quiet", cwd=folder)
                assert done.returncode == 0, done.stderr
            counts[name] = instructions(programs, words, folder, profiles / f"{name}.callgrind")
            print(f"{name}: {counts[name]}", flush=True)
    return counts, profiles


def main():
    programs = Programs(sys.argv[1])
    test_the_comparison()
    found = versions(programs)
    if "--store" in sys.argv[2:]:
        counts, _ = measure(programs)
        STORED.write_text(text_of(found, counts))
        return 0
    stored_versions, stored = read_stored(STORED.read_text())
    flags = set(re.search(r"(?m)^flags\s*:(.*)|\Z", pathlib.Path("/proc/cpuinfo").read_text())[0].split())
    reason = reason_to_skip(stored_versions, found, flags)
    if reason:
        print(f"skipped: {reason}\n  to store counts of this machine: {store_command()}")
        return SKIPPED
    assert set(stored) == set(COMMANDS), f"{STORED} holds {set(stored) ^ set(COMMANDS)} or lacks it"
    counts, profiles = measure(programs)
    misses = [miss(name, stored[name], count, profiles / f"{name}.callgrind")
              for name, count in counts.items()]
    misses = [text for text in misses if text]
    print("\n".join(misses))
    return 1 if misses else 0


if __name__ == "__main__":
    sys.exit(main())
