#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks what the compiler cannot: links and citations of the documents, and plain text.

- every relative link of a Markdown file leads to a file;
- every citation key such as [Steele14] in code or documents has an entry in docs/references.bib;
- no tracked file names a machine's own folders;
- every source says its licence (SPDX), and CITATION.cff the project's version.
"""

import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
CITATION = re.compile(r"\[([A-Z][A-Za-z]+[0-9]{2}[a-z]?)\]")
LICENCE = "SPDX-License-Identifier: Apache-2.0"
SOURCE = re.compile(r"\.(h|cpp|inc|js|css|py|cmake)$|CMakeLists\.txt$")
MACHINE_PATH = re.compile(r"/(?:home|root|work)/[a-z]")


def main() -> int:
    names = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
    bibliography = (ROOT / "docs/references.bib").read_text(encoding="utf-8")
    keys = set(re.findall(r"^@\w+\{(\w+),", bibliography, re.M))
    problems = []
    for name in filter(None, names):
        path = ROOT / name
        if path.suffix not in (".md", ".h", ".cpp", ".inc", ".js", ".css", ".cmake", ".py", ".toml", ".txt", "") or not path.is_file():
            continue
        if "/corpus/" in name or name == "scripts/check_docs.py":
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        if SOURCE.search(name) and not name.startswith("tests/data/") and LICENCE not in text[:1000]:
            problems.append(f"{name}:1: add the line {LICENCE}")
        for number, line in enumerate(text.splitlines(), 1):
            place = f"{name}:{number}"
            if path.suffix == ".md":
                for target in LINK.findall(line):
                    if "://" not in target and not (path.parent / target).exists():
                        problems.append(f"{place}: link to {target} leads nowhere")
            if path.suffix in (".md", ".h", ".cpp"):
                for key in CITATION.findall(line):
                    if key not in keys:
                        problems.append(f"{place}: [{key}] is not in docs/references.bib")
            if MACHINE_PATH.search(line):
                problems.append(f"{place}: names a machine's own folder")
    version = re.search(r"project\(haarlight VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())[1]
    if f"\nversion: {version}\n" not in (ROOT / "CITATION.cff").read_text():
        problems.append(f"CITATION.cff: the version is {version}")
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
