#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""No function is longer than MOST lines, from its first word to its last brace, tests included.

Told from the braces, in well under a second for all sources; the compilers see that they match.
"""

import pathlib
import re
import subprocess
import sys

MOST = 100

# What is no code: comments, raw strings, strings, characters (but for the ' in 10'000).
SILENT = re.compile(
    r'//[^\n]*|/\*.*?\*/|R"(?P<mark>[^(\s]*)\(.*?\)(?P=mark)"|"(?:\\.|[^"\\\n])*"|(?<![0-9a-fA-F])\'(?:\\.|[^\'\\\n])+\'',
    re.DOTALL)
DIRECTIVE = re.compile(r"^[ \t]*#(?:\\\n|[^\n])*", re.MULTILINE)
SCOPE = re.compile(r"\b(namespace|class|struct|union|enum)\b(?!.*\))|^extern$", re.DOTALL)
TEMPLATE = re.compile(r"^template\s*<[^{]*?>\s*(?=class\b|struct\b|union\b)")


def blank(match: re.Match) -> str:
    return re.sub(r"[^\n]", " ", match.group())


def functions(text: str):
    """(first line, last line, first words) of each function's definition."""
    text = DIRECTIVE.sub(blank, SILENT.sub(blank, text))
    depth = 0  # of braces inside a definition
    scopes = 0
    begin = 0  # where the declaration's text begins
    line = {}
    for match in re.finditer(r"[{};]|[^\s{};]+", text):
        at, word = match.start(), match.group()
        if word == "{":
            declaration = TEMPLATE.sub("", text[begin:at].strip())
            if depth == 0 and SCOPE.search(declaration):
                scopes, begin = scopes + 1, at + 1
            else:
                depth += 1
        elif word == "}":
            if depth == 0:
                scopes, begin = scopes - 1, at + 1
                continue
            depth -= 1
            # a{1}, b{2} {: the end of a member's start value is not the function's.
            if depth == 0 and not re.match(r"\s*[,{]", text[at + 1:]):
                words = text[begin:at].strip()
                start = begin + len(text[begin:at]) - len(text[begin:at].lstrip())
                signature = re.split(r"\)[^()]*\{", words)[0]
                if not re.search(r"(?<!operator)(?<![=<>!])=", re.sub(r"\(.*", "", signature, flags=re.DOTALL)):
                    yield (text.count("\n", 0, start) + 1, text.count("\n", 0, at) + 1,
                           " ".join(signature.split())[:60])
                begin = at + 1
        elif word == ";" and depth == 0:
            begin = at + 1
    if depth or scopes:
        raise ValueError(f"{depth + scopes} braces are open at its end")


def main() -> int:
    root = pathlib.Path(__file__).resolve().parent.parent
    files = subprocess.run(["git", "ls-files", "*.h", "*.cpp"], cwd=root, capture_output=True, text=True,
                           check=True).stdout.split()
    n_found = n_long = 0
    for name in files:
        try:
            for first, last, words in functions((root / name).read_text(encoding="utf-8")):
                n_found += 1
                if last - first + 1 > MOST:
                    n_long += 1
                    print(f"{name}:{first}: {last - first + 1} lines, {MOST} at most: {words}")
        except ValueError as error:
            n_long += 1
            print(f"{name}: {error}")
    print(f"{n_found} functions")
    return 1 if n_long else 0


if __name__ == "__main__":
    sys.exit(main())
