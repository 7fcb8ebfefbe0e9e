#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks what the compiler cannot: links and citations of the documents, and plain text.

- every relative link of a Markdown file leads to a file, and to a heading in it where it names one;
- docs/README.md lists every page of its folders, by its title;
- every citation key such as [Steele14] in code or documents has an entry in docs/references.bib;
- no tracked file names a machine's own folders;
- every source says its licence (SPDX), and CITATION.cff the project's version;
- prose (documents, comments, messages, visible text) uses the field's words: the table WORDS below.

    scripts/check_docs.py            prints what is wrong, exit code 1 if anything is
    scripts/check_docs.py --count    prints how often each of the words is found
"""

import bisect
import collections
import functools
import itertools
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)]*))?\)")
CITATION = re.compile(r"\[([A-Z][A-Za-z]+[0-9]{2}[a-z]?)\]")
LICENCE = "SPDX-License-Identifier: Apache-2.0"
SOURCE = re.compile(r"\.(h|cpp|inc|js|css|py|cmake)$|CMakeLists\.txt$")
MACHINE_PATH = re.compile(r"/(?:home|root|work)/[a-z]")
KINDS = (".md", ".h", ".cpp", ".inc", ".js", ".mjs", ".css", ".html", ".cmake", ".py", ".toml", ".txt", ".json", ".in", "")

# ---- words -----------------------------------------------------------------------------------

CPP = (".h", ".cpp", ".inc")

TARGETS = ("light", "lamp", "LED", "pixel", "frame", "face", "shot", "tile", "channel", "capture", "segment", "plane", "value",
           "texel", "element", "coefficient", "block", "receiver", "step", "scenario", "driver", "packet", "cell", "level",
           "colour", "row", "column", "direction", "byte", "number", "term", "request", "array", "case", "model", "side",
           "octave", "run", "process", "thread", "bin", "line", "file", "knot", "camera", "region", "page", "layer", "sheet",
           "axis", "wavelet", "pattern", "folder", "group", "change", "output", "picture", "object", "job", "register",
           "session", "kind", "verb", "module", "grid", "sample", "record", "question", "message", "set", "method", "format")
COUNTS = ("one", "two", "three", "four", "five", "six", "eight", "nine", "ten", "a", "an", r"\d+(?:[.,]\d+)*")
COUNTED = ("numbers", "bytes", "bits", "floats", "doubles", "coefficients", "products", "additions", "multiplications", "terms",
           "weights", "gains", "values", "frames", "shots", "planes", "look-ups", "entries", "unknowns", "pixels",
           "samples", "electrons", "flashes", "rays", "strata", "words", "texels", "knots", "ms", "us", "ns", "µs", "[kKMG]B", "mm",
           "points", "lines", "rows", "files", "blocks", "pages")
NOT_COUNTED = ("is", "if", "at", "in", "of", "on", "to", "for", "when", "where", "with", "as", "than", "like", "because", "without",
               "from", "that", "after", "before", "under", "over", "until", "unless", "per", "or", "and", "by", "off", "what",
               "how", "not", "but", "into", "along", "across", "it", "makes", "gives", "takes", "needs", "has", "moves", "leaves",
               "turns", "means", "becomes")

# (name, words that begin it or that it turns on, regular expression, what to write instead). A space stands for any
# white space, the end of a line with the next line's comment mark included. Case does not count.
WORDS = [
    ("stamp", ["stamp"], r"\b(?:time[ -])?stamp(?:s|ed|ing)?\b", "timestamp"),
    ("tag rows", ["tag"], r"\btag[ -]rows?\b", "embedded metadata rows"),
    ("share", ["share"],
     r"\b(?:an?|the|this|same|each|every|which|its|their|whose|own|equal|largest|smallest|least|small|large|lit|clipped|missing"
     r"|saturated|[a-z]+'s|as|by) shares?\b(?! (?:an?|the|its|their|one|all|no|out|some|this|that|what) )"
     r"|\bshares? of\b(?! what)|\bin shares\b", "fraction"),
    ("place", ["place"],
     r"\bplaces?\b(?![-(=]| (?:=|value|an?|the|it|them|one|its|each)\b)(?<!\bin place)(?<!\b(?:take|took) place)(?<!\btakes place)"
     r"(?<!\btaken place)(?<!\btaking place)(?<!\btake the place)(?<!\btakes the place)(?<!\btake its place)(?<!\btakes its place)"
     r"(?<!\btake their place)(?<!\bfirst place)(?<!\blast place)(?<!\bdecimal place)(?<!\bdecimal places)(?<!\bonly place)"
     r"(?<!\bone place)(?<!\btwo places)(?<!\bto place)(?<!\bin its place)(?<!\bin their place)", "position, index, location"),
    ("judge", ["judg"], r"\bjudg(?:e|es|ed|ing|e?ments?)\b", "validate, classify, assess"),
    ("recipe", ["recipe"], r"\brecipes?\b", "parameters"),
    ("hurry", ["hurr"], r"\bhurr(?:y|ied|ies)\b", "retry policy"),
    ("gossip", ["gossip"], r"\bgossip\w*", "best-effort log lines"),
    ("house", ["house"], r"\b(?:un)?house(?:d|s)?\b", "copy out; pool exhausted"),
    ("desk", ["desk"], r"\bdesks?\b", "cache, worker"),
    ("person", ["person"], r"\bpersons?\b", "operator, user"),
    ("cure", ["cur"], r"\bcur(?:e|es|ed|ing)\b", "hint, what to do"),
    ("drives", ["drive"],
     r"\b(?:the|their|these|those|of|under|with|list of|equal|new|coloured|same|very|lights'|save|one|its|from|and) drives\b"
     r"(?! (?:the|an?|it|them|its|lights|every|one|leds)\b)|\bdrives (?:of|that|for|are|below|above)\b"
     r"|(?<!usb )(?<!disk )\bdrives\b(?=[.,;:)])"
     r"|\b(?:at|unit) drive (?:1|one)\b|\ba drive (?:of|for|per|a|above|below)\b", "light weights"),
    ("put out", ["put"], r"\bput(?:s|ting)?(?: [\w'*]+){0,3} out\b", "turn off"),
    ("asked/reached", ["asked", "reached"],
     r"\b(?:errors?|bound|accuracy|exposure|region)(?: that)?(?: (?:it|they))? (?:asked|reached)\b|\btarget (?:was|is) (?:not )?reached\b"
     r"|\bwhat (?:was|is|were|error was) (?:asked|reached)\b|\b(?:asked|target) and reached\b|\basked, reached\b"
     r"|\b(?:reached|asked) (?:error|bound)s?\b", "requested, achieved"),
    ("large buffer", ["largebuffer"], r"\bLargeBuffer\w*", "huge-page buffer"),
    ("knot", ["knot"], r"\bknots?\b", "RBF centre, grid node"),
    ("a light", [" a ", " an "],
     rf"(?:\b(?:{'|'.join(COUNTS)}) (?!(?:{'|'.join(NOT_COUNTED)}) )[\w-]+|(?<!\w)(?:{'|'.join(COUNTED)})|\b(?:one|two|three|four)"
     rf"|(?<![.,\w])\d+) (?-i:an?) (?:{'|'.join(TARGETS)})\b(?!'| (?:must|may|can|would|uses|has|holds|needs|shows|is|was|\d))",
     "one weight per light, bytes per pixel"),
]
WORDS = [(name, stems, re.compile(pattern, re.IGNORECASE), instead) for name, stems, pattern, instead in WORDS]

# Names in code, of the words that were the project's own.
NAMES = re.compile(r"[Hh]urry|[Gg]ossip|[Uu]nhoused|[Jj]udge|[Rr]ecipe|(?<![A-Za-z])knot|Knot|Desk|desk(?!top)|LargeBuffer|large_buffer")

# (file, the exact text, why it stays).
ALLOWED = [("relight/pipeline/fit/fit_report.cpp", '"clipped share"', "a key of the report")]

FENCED = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:(?<=\n\n)|\A)(?: {4}.*(?:\n|\Z)|\n(?= {4}))+")
NO_PROSE = re.compile(r"`[^`\n]+`|\\?\"[\w.-]+\\?\"(?=\s*[:,}\]])|(?<![\w.])[.#][a-z][\w-]*|\]\([^)\s]*\)"
                      r"|<?\bhttps?://[^\s>)]+>?|(?<![\w.])[\w.-]*/[\w./-]*|--[\w-]+")
LITERALS = {
    "c": re.compile(r'(?P<c>//[^\n]*|/\*.*?\*/)|R"(?P<d>\w*)\((?P<r>.*?)\)(?P=d)"|"(?P<s>(?:\\.|[^"\\\n])*)"'
                    r"|'(?:\\.|[^'\\\n])'", re.DOTALL),
    "js": re.compile(r'(?P<c>(?<![:\'"\\])//[^\n]*|/\*.*?\*/)|`(?P<r>(?:\\.|[^`\\])*)`|"(?P<s>(?:\\.|[^"\\\n])*)"'
                     r"|'(?P<t>(?:\\.|[^'\\\n])*)'", re.DOTALL),
    "py": re.compile(r'(?P<c>#[^\n]*)|"""(?P<r>.*?)"""|"(?P<s>(?:\\.|[^"\\\n])*)"|\'(?P<t>(?:\\.|[^\'\\\n])*)\'', re.DOTALL),
    "#": re.compile(r'(?P<c>(?<!\S)#[^\n]*)|"(?P<s>(?:\\.|[^"\\\n])*)"'),
    "json": re.compile(r'(?P<c>(?!))|"(?P<s>(?:\\.|[^"\\\n])*)"'),
    "html": re.compile(r'<!--(?P<c>.*?)-->|<(?:script|style).*?</(?:script|style)>'
                       r'|(?:title|alt|placeholder|aria-label|content)="(?P<s>[^"]*)"|<[^>\"]*(?:\"[^\"]*\"[^>\"]*)*>', re.DOTALL),
}
FILLED_IN = {"js": re.compile(r"\$\{[^{}]*\}"), "py": re.compile(r"\{[^{}\n]*\}")}  # what a text is completed with
CODE = re.compile(r"[;{][ \t]*\n|^[ \t]*[\w.]+ = ", re.MULTILINE)
COMMENT_MARK = re.compile(r"^[ \t]*(?://[/!]?<?|/?\*+|#+)|(?<=\s)//[/!]?<?", re.MULTILINE)


def blank(text, mark=" "):
    return re.sub(r"[^\n]", mark, text)


def language(path, text):
    if re.match(r"#!.*python", text):
        return "py"
    kinds = {**dict.fromkeys(CPP, "c"), ".css": "c", ".js": "js", ".mjs": "js", ".py": "py", ".json": "json", ".html": "html", ".md": "md"}
    return kinds.get(path.suffix, "#")


def prose_of(text, kind):
    """The text with everything but prose blanked out, as long as before: code (as 0), paths, options, keys (as 1)."""
    if kind == "md":
        text = FENCED.sub(lambda m: blank(m[0]), text)
        text = INDENTED.sub(lambda m: re.sub(r"^.*?(?=  # |$)", lambda line: blank(line[0]), m[0], flags=re.MULTILINE), text)
    elif kind == "html":
        shown = LITERALS[kind].sub(lambda m: blank(m[0]) if m["c"] is None and m["s"] is None else
                                   blank(m[0][:m.start(m.lastgroup) - m.start()]) + m[m.lastgroup] +
                                   blank(m[0][m.end(m.lastgroup) - m.start():]), text)
        text = shown
    else:
        shown, end = [], 0
        for found in LITERALS[kind].finditer(text):
            shown.append(re.sub(r"[^\s]", "\x00", text[end:found.start()]))
            end = found.end()
            inner = next((name for name in ("c", "r", "s", "t") if found.groupdict().get(name) is not None), None)
            if inner is None or LICENCE in found[0] or inner != "c" and (" " not in found[inner].strip() or CODE.search(found[inner])):
                shown.append(blank(found[0], "\x01"))  # a key, a character, a program or a file
                continue
            begin, stop = found.start(inner) - found.start(), found.end(inner) - found.start()
            words = found[inner].replace("\\n", "  ")
            if inner != "c" and kind in FILLED_IN:
                words = FILLED_IN[kind].sub(lambda m: blank(m[0], "\x01"), words)
            shown.append(blank(found[0][:begin]) + words + blank(found[0][stop:]))
        text = "".join(shown) + re.sub(r"[^\s]", "\x00", text[end:])
        text = COMMENT_MARK.sub(lambda m: blank(m[0]), text)
    return NO_PROSE.sub(lambda m: blank(m[0], "\x01"), text)


def matches(flowing, stems, pattern):
    """What a rule finds. Only the surroundings of its stems are searched: that is ten times faster."""
    lower, seen = flowing.lower(), set()
    for stem in stems:
        at = lower.find(stem)
        while at >= 0:
            for m in pattern.finditer(flowing, max(0, at - 50), at + 60):
                if m.start() <= at + len(stem) <= m.end() + 1 and m.start() not in seen:
                    seen.add(m.start())
                    yield m
            at = lower.find(stem, at + 1)


def words_in(text, path):
    """(line, name of the rule, what stands there, what to write instead) of everything in a file that the rules forbid."""
    kind = language(path, text)
    prose = prose_of(text, kind)
    starts = [0] + [m.end() for m in re.finditer("\n", text)]
    tokens = list(re.finditer(r"\S+", prose))
    flowing = " ".join(token[0] for token in tokens)
    begins = list(itertools.accumulate((len(token[0]) + 1 for token in tokens), initial=0))
    found = [(tokens[bisect.bisect_right(begins, m.start()) - 1].start(), name, m[0], instead)
             for name, stems, pattern, instead in WORDS for m in matches(flowing, stems, pattern)]
    if kind in ("c", "js", "py"):
        found += [(m.start(), f"{m[0].lower().rstrip('s')} in a name", m[0], "the word that prose has for it")
                  for m in NAMES.finditer(text) if prose[m.start()] == "\x00"]
    if kind == "md":
        plate = re.search(r"(?<!\bclean )(?<!\bthin )(?<!-)\bplates?\b", prose, re.IGNORECASE)
        if plate and not re.search(r"\bclean\s+plate", prose[:plate.start()], re.IGNORECASE):
            found.append((plate.start(), "plate", plate[0], "clean plate, when it is first named"))
    lines = text.split("\n")
    for at, name, words, instead in sorted(found):
        line = bisect.bisect_right(starts, at)
        if not any(path == pathlib.Path(file) and allowed in lines[line - 1] for file, allowed, _ in ALLOWED):
            yield line, name, " ".join(words.split()), instead


# ---- everything ------------------------------------------------------------------------------


def texts():
    """(name, text) of every file that is checked."""
    names = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
    for name in filter(None, names):
        path = ROOT / name
        if path.suffix in KINDS and path.is_file() and "/corpus/" not in name and name != "scripts/check_docs.py":
            yield name, path.read_text(encoding="utf-8", errors="replace")


@functools.cache
def headings(path):
    """The anchors of a Markdown file's headings."""
    titles = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def leads_somewhere(path, heading):
    return path.exists() and (not heading or path.suffix != ".md" or heading in headings(path))


def unlisted():
    """What docs/README.md lacks."""
    rows = re.findall(r"^- \[([^\]]+)\]\(([^)]+)\)", (ROOT / "docs/README.md").read_text(encoding="utf-8"), re.MULTILINE)
    for folder in ("guides", "reference", "numerics", "decisions"):
        for page in sorted((ROOT / "docs" / folder).glob("*.md")):
            title = page.read_text(encoding="utf-8").split("\n", 1)[0].removeprefix("# ")
            if (title, f"{folder}/{page.name}") not in rows:
                yield f"docs/README.md: add the row - [{title}]({folder}/{page.name})"


def problems_of(name, text, keys):
    path = ROOT / name
    if SOURCE.search(name) and not name.startswith("tests/data/") and LICENCE not in text[:1000]:
        yield f"{name}:1: add the line {LICENCE}"
    for number, line in enumerate(text.splitlines(), 1):
        at = f"{name}:{number}"
        if path.suffix == ".md":
            for target, heading in LINK.findall(line):
                if "://" not in target and not leads_somewhere(path.parent / target if target else path, heading):
                    yield f"{at}: link to {target}{'#' * bool(heading)}{heading} leads nowhere"
        if path.suffix in (".md", ".h", ".cpp"):
            for key in CITATION.findall(line):
                if key not in keys:
                    yield f"{at}: [{key}] is not in docs/references.bib"
        if MACHINE_PATH.search(line):
            yield f"{at}: names a machine's own folder"
        if line.startswith(("<<<<<<< ", ">>>>>>> ")):
            yield f"{at}: left of a merge: choose one of the two"


def is_searched(name):
    return name not in ("LICENSE", "tests/packaging/words_test.py")


def count():
    """Prints how often each word is found."""
    counts = collections.Counter(dict.fromkeys([name for name, *_ in WORDS] + ["plate"], 0))
    for name, text in texts():
        if is_searched(name):
            counts.update(word for _, word, *_ in words_in(text, pathlib.Path(name)))
    for word, n in counts.items():
        print(f"{n:6} {word}")
    return 1 if counts.total() else 0


def main() -> int:
    if sys.argv[1:] == ["--count"]:
        return count()
    bibliography = (ROOT / "docs/references.bib").read_text(encoding="utf-8")
    keys = set(re.findall(r"^@\w+\{(\w+),", bibliography, re.M))
    problems = list(unlisted())
    for name, text in texts():
        problems += problems_of(name, text, keys)
        if is_searched(name):
            problems += [f"{name}:{line}: \"{words}\": write {instead} ({word})"
                         for line, word, words, instead in words_in(text, pathlib.Path(name))]
    version = re.search(r"project\(haarlight VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())[1]
    if f"\nversion: {version}\n" not in (ROOT / "CITATION.cff").read_text():
        problems.append(f"CITATION.cff: the version is {version}")
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
