#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Every function of a public header is reached from a program: check_reached.py

Names each function, method and constructor below include/haarlight that neither one of our programs nor
tests/consumer reaches, with its header and line, unless scripts/reached_exceptions.txt lists it with a
reason; and each entry of that list that is not needed. Needs build/dev and build/release as ./check
leaves them.

Declarations come from clang's syntax tree of all public headers, calls from the object
files: in the sanitizers' build of the libraries nothing is inlined (clang -O1) and each function has a
section of its own (the fuzzers' coverage), so that a call is a relocation from section to section. The
walk begins with all that the objects of build/release/apps and tests/consumer's sources refer to.

What it cannot see:
- Virtual methods count as reached with their class's constructor, tables of function pointers as a whole.
- A function that an `if` never calls at run time counts as called.
- Of functions with a body in a header (inline, constexpr, templates) calls may have been inlined into a
  program or folded. Where no object holds one, its name in a program's source, in that of a library
  object that is reached, or in another inline function suffices; of operators nothing is asked.
- Templates are told by name, without their arguments and overloads.
- Implicit, defaulted, deleted and pure virtual functions, destructors, and what copies or moves are not
  looked at.
"""

import collections
import concurrent.futures
import hashlib
import json
import os
import pathlib
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
COMPILER = ["clang++", "-std=c++20", "-isystem", "/usr/include/eigen3"]

# ---------------------------------------------------------------- what is declared

COPY_OR_MOVE = re.compile(r"\((const )?[\w:]+ &&?\)")
FUNCTIONS = {"FunctionDecl", "CXXMethodDecl", "CXXConstructorDecl", "CXXConversionDecl"}


class Function:
    """A function of a public header. `symbol` is None for templates and members of class templates."""

    def __init__(self, name, parameters, symbol, header, line, has_body):
        self.name, self.parameters, self.symbol = name, parameters, symbol
        self.header, self.line, self.has_body = header, line, has_body

    def __str__(self):
        return self.name + self.parameters


class SyntaxTree:
    """Reads clang's tree, which tells file and line only where they change."""

    def __init__(self, include):
        self.include = include
        self.file, self.line = "", 0
        self.functions = {}

    def place(self, node):
        """Follows the positions of a node's `loc` and `range`, in the order they were written."""
        first = None
        for key in ("loc", "range"):
            for position in self.positions(node.get(key, {})):
                self.file = position.get("file", self.file)
                self.line = position.get("line", self.line)
                if key == "loc":
                    first = (self.file, self.line)
        return first or (self.file, self.line)

    def positions(self, value):
        if "offset" in value or "line" in value:
            yield value
        for key, inner in value.items():
            if isinstance(inner, dict) and key != "includedFrom":
                yield from self.positions(inner)

    def read(self, node, scope=(), is_template=False):
        file, line = self.place(node)
        kind = node.get("kind", "")
        is_lambda = node.get("definitionData", {}).get("isLambda", False)
        inner = [child for child in node.get("inner", []) if isinstance(child, dict)]
        if kind in FUNCTIONS:
            self.add(node, inner, "::".join((*scope, node.get("name", "").split("<")[0])), file, line, is_template)
        name = node.get("name", "")
        if kind in ("NamespaceDecl", "CXXRecordDecl") and name:
            scope = (*scope, name)
        if kind == "FriendDecl":
            scope = scope[:-1]
        is_template = is_template or kind in ("ClassTemplateDecl", "FunctionTemplateDecl")
        is_opaque = kind in FUNCTIONS or kind == "ClassTemplateSpecializationDecl" or is_lambda
        is_pattern_read = False  # what a template was made into stands after its pattern
        for child in inner:
            is_declaration = child.get("kind") in FUNCTIONS or child.get("kind") == "CXXRecordDecl"
            if is_opaque or (kind.endswith("TemplateDecl") and is_declaration and is_pattern_read):
                self.follow(child)
            else:
                self.read(child, scope, is_template)
                is_pattern_read = is_pattern_read or is_declaration

    def follow(self, node):
        """Positions alone."""
        self.place(node)
        for child in node.get("inner", []):
            if isinstance(child, dict):
                self.follow(child)

    def add(self, node, inner, name, file, line, is_template):
        skipped = ("isImplicit", "explicitlyDefaulted", "explicitlyDeleted", "pure")
        if any(node.get(key) for key in skipped) or not file.startswith(str(self.include)):
            return
        parameters = parameters_of(node["type"]["qualType"])
        if COPY_OR_MOVE.fullmatch(parameters) and node["name"] in ("operator=", name.split("::")[-2]):
            return
        symbol = None if is_template else node.get("mangledName")
        has_body = is_template or any(child.get("kind") == "CompoundStmt" for child in inner)
        key = canonical(symbol) if symbol else name
        known = self.functions.get(key)
        if known:  # declared in its class, defined below it
            known.has_body |= has_body
        else:
            header = pathlib.Path(file).relative_to(self.include).as_posix()
            self.functions[key] = Function(name, parameters, symbol and key, header, line, has_body)


def parameters_of(kind):
    """(int, const T &) of `std::span<const int> (int, const T &) const noexcept`."""
    depth = 0
    for at, letter in enumerate(kind):
        depth += {"<": 1, ">": -1}.get(letter, 0)
        if letter == "(" and depth == 0:
            return kind[at:kind.rindex(")") + 1]
    return ""


def declared_functions(include):
    headers = sorted(path.relative_to(include).as_posix() for path in include.rglob("*.h"))
    includes = "".join(f'#include "{header}"\n' for header in headers)
    done = subprocess.run(
        [*COMPILER, f"-I{include}", "-fsyntax-only", "-x", "c++", "-", "-Xclang", "-ast-dump=json",
         "-Xclang", "-ast-dump-filter=haarlight"],
        input=includes, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"the public headers do not compile:\n{done.stderr}")
    tree, decoder, at, text = SyntaxTree(include), json.JSONDecoder(), 0, done.stdout
    while at < len(text.rstrip()):
        node, at = decoder.raw_decode(text, at)
        if node.get("kind") == "NamespaceDecl":
            tree.read(node)
        else:
            tree.follow(node)
        while at < len(text) and text[at].isspace():
            at += 1
    return list(tree.functions.values())


# ---------------------------------------------------------------- calls

LOCAL = 0  # STB_LOCAL
CONSTRUCTOR = re.compile(r"C[123](?=[EI])")


def canonical(symbol):
    """A class's complete and base constructor are one."""
    return CONSTRUCTOR.sub("C1", symbol)


class ObjectFile:
    """Sections, symbols and relocations of a 64-bit ELF file."""

    def __init__(self, path):
        self.path = path
        data = path.read_bytes()
        if data[:6] != b"\x7fELF\x02\x01":
            sys.exit(f"{path} is not a 64-bit object file: check_reached.py reads ELF alone")
        self.data = data
        (start,) = struct.unpack_from("<Q", data, 40)
        size, number, names = struct.unpack_from("<HHH", data, 58)
        sections = [struct.unpack_from("<IIQQQQIIQQ", data, start + i * size) for i in range(max(number, 1))]
        if number == 0:  # more than a short integer holds
            number = sections[0][5]
            names = sections[0][6] if names == 0xffff else names
            sections = [struct.unpack_from("<IIQQQQIIQQ", data, start + i * size) for i in range(number)]
        self.names = [self.text(sections[names][4] + section[0]) for section in sections]
        self.relocations = {}  # section -> (offset, size) in the file
        self.symbols = []  # (name, section or 0, binding)
        extended = {}
        for section in sections:
            if section[1] == 4:  # SHT_RELA
                self.relocations.setdefault(section[7], []).append((section[4], section[5]))
            elif section[1] == 18:  # SHT_SYMTAB_SHNDX
                extended = dict(enumerate(struct.unpack_from(f"<{section[5] // 4}I", data, section[4])))
        for section in sections:
            if section[1] == 2:  # SHT_SYMTAB
                strings = sections[section[6]][4]
                table = data[section[4]:section[4] + section[5]]
                for i, (name, info, _, where, _, _) in enumerate(struct.iter_unpack("<IBBHQQ", table)):
                    where = extended[i] if where == 0xffff else where if where < 0xff00 else 0
                    self.symbols.append((self.text(strings + name), where, info >> 4))

    def text(self, at):
        return self.data[at:self.data.index(b"\0", at)].decode()

    def references(self, section):
        """What one section refers to: symbols as numbers."""
        found = set()
        for at, size in self.relocations.get(section, []):
            found.update(info >> 32 for _, info, _ in struct.iter_unpack("<QQq", self.data[at:at + size]))
        return found


class Libraries:
    """The libraries' objects, section by section. `again(source)` compiles a source without inlining."""

    def __init__(self, files, again):
        self.sources = [source for source, _ in files]
        self.objects = [ObjectFile(made) for _, made in files]
        self.again = again
        self.compiled_again = set()
        self.defined = {}  # symbol -> (number of the object, section)
        self.define(range(len(files)))

    def define(self, numbers):
        for number in numbers:
            file = self.objects[number]
            for name, section, binding in file.symbols:
                if section and binding != LOCAL:
                    # Functions that never return are not counted by the coverage and share .text.
                    if file.names[section] == ".text" and not any(n.startswith(".text.") for n in file.names):
                        sys.exit(f"{file.path}: {name} has no section of its own: build with -ffunction-sections")
                    if number in self.compiled_again or name not in self.defined:
                        self.defined[name] = (number, section)

    def reached_from(self, roots):
        """(symbols, numbers of the objects) that the roots lead to."""
        symbols, objects, sections = set(), set(), set()
        names, places = list(roots), []
        while names or places:
            if names:
                name = names.pop()
                if name not in symbols:
                    symbols.add(name)
                    places += [self.defined[name]] if name in self.defined else []
                continue
            number, section = place = places.pop()
            if place in sections:
                continue
            sections.add(place)
            file = self.objects[number]
            if number not in objects:  # what runs before main()
                objects.add(number)
                places += [(number, i) for i, name in enumerate(file.names) if name.startswith(".init_array")]
            for index in file.references(section):
                name, where, binding = file.symbols[index]
                if binding == LOCAL:
                    places.append((number, where))
                else:
                    names.append(name)
        return symbols, objects

    def without_inlining(self, symbols, reached):
        """Compiles again the reached objects that define these symbols; whether there were any."""
        wanted = {number for name, (number, _) in self.defined.items() if canonical(name) in symbols}
        wanted = wanted & reached - self.compiled_again
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            made = dict(zip(wanted, pool.map(lambda number: self.again(self.sources[number]), wanted)))
        for number, path in made.items():
            self.defined = {name: place for name, place in self.defined.items() if place[0] != number}
            self.objects[number] = ObjectFile(path)
            self.compiled_again.add(number)
        self.define(range(len(self.objects)) if made else [])
        return bool(made)


def demangled(symbols):
    """Names without arguments: haarlight::Image::row of haarlight::Image<float>::row(int) const."""
    ours = sorted(symbol for symbol in symbols if "9haarlight" in symbol)
    done = subprocess.run(["c++filt"], input="\n".join(ours), capture_output=True, text=True, check=True)
    return {without_arguments(line) for line in done.stdout.split("\n")}


def without_arguments(name):
    """Of a template's instance `void f<g(int)>(int)` f; a return type stands before it."""
    kept, depth = "", 0
    name = name.replace("operator()", "operator\0").replace("(anonymous namespace)", "")
    for letter in name:
        if letter in "<(":
            if letter == "(" and depth == 0:
                break
            depth += 1
        elif letter in ">)":
            depth -= 1
        elif depth == 0:
            kept += letter
    return kept.split(" ")[-1].replace("\0", "()")


# ---------------------------------------------------------------- the verdict

COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.S)


def count_words(paths):
    """How often each word stands in the code of these files."""
    texts = (COMMENT.sub("", path.read_text(encoding="utf-8")) for path in paths)
    return collections.Counter(word for text in texts for word in re.findall(r"\w+", text))


MOST_MISSING = 5  # sources of libraries that no test links: they are compiled here


class Build:
    """The compile commands of a build folder, for the sources below `rooms`."""

    def __init__(self, folder, rooms):
        database = folder / "compile_commands.json"
        if not database.is_file():
            sys.exit(f"{database} is missing: run ./check, or build the presets dev and release")
        self.folder, self.commands = folder, {}
        for entry in json.loads(database.read_text()):
            source = pathlib.Path(entry["file"])
            if any(room in source.parents for room in rooms):
                self.commands[source] = shlex.split(entry["command"])

    def objects(self, instead=None):
        """(source, object) of each. `instead(source)` makes one that was not built: no test links it."""
        made = {source: self.folder / words[words.index("-o") + 1] for source, words in self.commands.items()}
        missing = [source for source, path in made.items() if not path.is_file()]
        if len(missing) > (0 if instead is None else MOST_MISSING):
            sys.exit(f"{made[missing[0]]} is missing: build it first (./check does)")
        made |= {source: instead(source) for source in missing}
        return list(made.items())

    def again(self, source, to):
        """Compiles a source without inlining, sanitizers and precompiled headers."""
        words = self.commands[source][1:]
        for option in ("-include", "-o", "-c"):
            at = words.index(option)
            words = words[:at] + words[at + 2:]
        return compile_plainly(source, to, [word for word in words if not word.startswith(("-O", "-g", "-f", "-W"))])


def compile_plainly(source, to, words):
    made = to / f"{hashlib.sha256(str(source).encode()).hexdigest()}.o"
    launcher = ["env", f"CCACHE_BASEDIR={ROOT}", "CCACHE_NOHASHDIR=1", "ccache"] if shutil.which("ccache") else []
    subprocess.run([*launcher, *COMPILER, *words, "-O0", "-ffunction-sections", "-c", source, "-o", made], check=True)
    return made


def exceptions_of(path):
    """name -> line of the list"""
    found = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line.strip() and not line.startswith("#"):
            name, _, reason = line.partition(" — ")
            if not reason.strip():
                sys.exit(f"{path}:{number}: write `qualified name(parameters) — reason`")
            found[name.strip()] = number
    return found


class Programs:
    """What the walk begins with."""

    def __init__(self, objects, sources):
        self.roots = {name for path in objects for name, _, binding in ObjectFile(path).symbols if binding != LOCAL}
        self.sources = sources


def unreached(functions, headers, libraries, programs):
    """The declared functions that the programs do not reach."""
    while True:
        symbols, objects = libraries.reached_from(programs.roots)
        reached, names = {canonical(symbol) for symbol in symbols}, demangled(symbols)
        left = [function for function in functions
                if function.symbol not in reached and not (function.symbol is None and function.name in names)]
        # One that is called in its own source alone may have been inlined there.
        if not libraries.without_inlining({f.symbol for f in left if not f.has_body}, objects):
            break
    used = count_words([*programs.sources, *(libraries.sources[number] for number in objects)])
    in_headers = count_words(headers)
    declared = collections.Counter(function.name.split("::")[-1] for function in functions)

    def is_named(function):
        word = function.name.split("::")[-1]
        is_operator = re.match(r"operator\W", word)
        return function.has_body and (is_operator or used[word] > 0 or in_headers[word] > declared[word])

    return [function for function in left if not is_named(function)]


def problems_of(functions, exceptions, place):
    """Lines to print. exceptions: as exceptions_of() reads them from `place`"""
    found = []
    for function in functions:
        if str(function) not in exceptions:
            found.append(f"include/{function.header}:{function.line}: no program reaches {function}: use it, make it "
                         f"private, delete it, or list it in {place} with its reason")
    for name, line in exceptions.items():
        if name not in map(str, functions):
            found.append(f"{place}:{line}: {name} is reached, or there is none: take it off the list")
    return found


def main():
    exceptions = ROOT / "scripts/reached_exceptions.txt"
    rooms = [path.parent for path in ROOT.glob("*/CMakeLists.txt") if path.parent.name not in ("apps", "tests", "bench")]
    library, apps = Build(ROOT / "build/dev", rooms), Build(ROOT / "build/release", [ROOT / "apps"])
    consumer = sorted((ROOT / "tests/consumer").glob("*.cpp"))
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            made = list(pool.map(lambda source: compile_plainly(source, folder, [f"-I{ROOT}/include"]), consumer))
        programs = Programs([*(path for _, path in apps.objects()), *made],
                            [*consumer, *(ROOT / "apps").rglob("*.h"), *apps.commands])
        functions = declared_functions(ROOT / "include")

        def again(source):
            return library.again(source, folder)

        libraries = Libraries(library.objects(again), again)
        left = unreached(functions, (ROOT / "include").rglob("*.h"), libraries, programs)
    problems = problems_of(left, exceptions_of(exceptions), exceptions.relative_to(ROOT))
    print("\n".join(problems) or f"{len(functions)} public functions: {len(left)} listed, all others reached")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
