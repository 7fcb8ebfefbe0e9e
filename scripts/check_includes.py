#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the includes against the architecture (docs/architecture.md).

A module's public headers are below include/haarlight, by the module's folders; they include no private
one. Every module may include its own files and those of the modules listed for it. Third-party headers that
are slow or that would leak a device's types stay inside .cpp files. A source includes the header of
its own name first: so each build shows that the header stands alone. And two rules that are no
includes: JSON has one way in, and no test asserts that it was fast.
"""

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent

ROOMS = {
    "core": set(),
    "firmware_iface": {"core"},
    "session": {"core"},
    "render": {"core"},
    "http": {"core"},
    "capture": {"core", "firmware_iface", "session", "http"},
    "relight": {"core", "session", "render"},
    "sim": {"core", "firmware_iface", "render"},
    "apps": {"core", "firmware_iface", "session", "render", "http", "capture", "relight", "sim"},
    "tests": None,
    "bench": None,
}

# Single files of a module that another module may include all the same.
DOORS = {
    "sim": {"capture/camera/camera.h", "capture/camera/remote_camera_protocol.h", "capture/camera/metadata_rows.h"},
}

# Headers only a .cpp may see, and, where a list stands, only these files.
CPP_ONLY = {
    r"modbus/": None,
    r"libusb": ["firmware_iface/usb_link.cpp"],
    r"usbredirparser\.h": None,
    r"umockdev\.h": None,
    r"linux/videodev2\.h": None,
    r"microhttpd\.h": ["http/server.cpp"],
    r"sqlite3\.h": None,
    r"toml\+\+/": ["core/config_table.cpp"],
    r"nlohmann/": None,
    r"spdlog/": ["core/log.cpp"],
    r"png\.h": ["core/picture/picture_png.cpp"],
    r"lcms2\.h": ["core/picture/picture_colour.cpp"],
    r"libraw/": ["core/picture/picture_raw.cpp"],
    r"Imf": ["core/picture/picture_exr.cpp"],
    r"embree[34]/": ["render/rays/ray_caster.cpp"],
    r"ceres/": None,
    r"opencv2/": None,
    r"tiffio\.h": None,
    r"jpeglib\.h": ["core/picture/jpeg.cpp"],
    r"tbb/": ["core/parallel.cpp"],
    r"mpi\.h": ["core/ranks.cpp"],
    r"curl/": None,
    r"CLI/": ["apps/command_line.cpp"],
    r"systemd/": None,
    r"zstd\.h": None,
    r"pugixml\.hpp": ["render/cell_mesh/vtu_reader.cpp"],
    r"xxhash\.h": None,
    r"openssl/": ["core/sha256.cpp"],
}

# A JSON text goes through parse_json, which limits its depth; what we wrote ourselves need not.
FREE_PARSE = re.compile(r"[jJ]son::(parse|accept|sax_parse)\((?!(session::)?evidence_to_json\()")

# No test asserts that it was fast: on a loaded machine nothing is. A promise in time is held under
# virtual time (core/virtual_clock.h), what a wire or the system does by counts and order.
ASSERTION = re.compile(r"\b(?:EXPECT|ASSERT)_(L[TE]|NEAR|TRUE)\s*\(([^;]*)\)[^;()]*;")
REAL_MOMENT = re.compile(r"\b(\w+)\s*=\s*(?:\w+::)*(?:steady_clock|Clock)::now\(\)\s*;")
PASSED = r"(?:steady_clock|Clock)::now\(\)\s*-(?!>)"

INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')


PUBLIC = "include/haarlight/"


def upper_bounds_on_wall_time(text: str) -> list[int]:
    """The lines of a test that assert that little real time has passed."""
    moments = "|".join(REAL_MOMENT.findall(text)) or "(?!)"
    passed = rf"(?:{PASSED}|\b(?:{moments})\s*-\s*(?:{moments})\b)"
    lengths = "|".join(re.findall(rf"\b(\w+)\s*=[^;=]*{passed}", text)) or "(?!)"
    lines = []
    for match in ASSERTION.finditer(text):
        kind, arguments = match.groups()
        measured = arguments.split("<")[0] if kind == "TRUE" else arguments.split(",")[0]
        if kind == "TRUE" and "<" not in arguments:
            continue
        if re.search(rf"{passed}|\b(?:{lengths})\b", measured):
            lines.append(text.count("\n", 0, match.start()) + 1)
    return lines


def problems_of(path: pathlib.Path) -> list[str]:
    name = path.relative_to(ROOT).as_posix()
    is_public = name.startswith(PUBLIC)
    room = name.removeprefix(PUBLIC).split("/")[0]
    allowed = ROOMS[room]
    found = []
    own = path.with_suffix(".h").relative_to(ROOT).as_posix()
    if (ROOT / PUBLIC / own).exists():
        own = f"haarlight/{own}"
    first = None
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        match = INCLUDE.match(line)
        if not match:
            continue
        quote, header = match.groups()
        first = first or header
        target = header.removeprefix("haarlight/").split("/")[0]
        if quote == '"' and target not in ROOMS:
            found.append(f"{name}:{number}: \"{header}\" is not written from the root")
        elif quote == '"' and is_public and not header.startswith("haarlight/"):
            found.append(f"{name}:{number}: public, and includes the private {header}")
        elif quote == '"' and allowed is not None and target != room and target not in allowed:
            if header not in DOORS.get(room, set()):
                found.append(f"{name}:{number}: {room} may not include {header}")
        for pattern, files in CPP_ONLY.items():
            if not re.match(pattern, header) or room in ("tests", "bench"):
                continue
            if path.suffix != ".cpp":
                found.append(f"{name}:{number}: <{header}> belongs in a .cpp file")
            elif files is not None and name not in files:
                found.append(f"{name}:{number}: only {', '.join(files)} may include <{header}>")
    if room not in ("tests", "bench"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if FREE_PARSE.search(line) and name != "core/text_limits.h":
                found.append(f"{name}:{number}: JSON is read by parse_json (core/text_limits.h)")
    if room == "tests":
        for number in upper_bounds_on_wall_time(path.read_text(encoding="utf-8")):
            found.append(f"{name}:{number}: an upper bound on real time: use core/virtual_clock.h, "
                         "or count or order what happens")
    if path.suffix == ".cpp" and first != own and any((ROOT / base / own).exists() for base in ("", "include")):
        found.append(f"{name}: its first include is not \"{own}\"")
    return found


def main() -> int:
    problems = []
    for folder in ("include", *ROOMS):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".h", ".cpp"):
                problems += problems_of(path)
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
