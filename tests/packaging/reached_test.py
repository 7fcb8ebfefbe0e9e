#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""scripts/check_reached.py finds what no program reaches: on a made library of which that is known.
reached_test.py"""

import pathlib
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.dont_write_bytecode = True
sys.path.insert(0, str(SOURCE / "scripts"))
import check_reached  # noqa: E402

HEADER = """\
#pragma once
namespace haarlight::made {
int called(int value);
int called_by_a_called_one(int value);
int called_by_a_local_one(int value);
int never_called(int value);
int called_by_never_called(int value);
int overloaded(int value);
int overloaded(double value);
inline int inline_called(int value) { return value + 1; }
inline int inline_never_called(int value) { return value + 2; }
template <class T>
T template_called(T value) { return value; }
template <class T>
T template_never_called(T value) { return value; }
class Shape {
 public:
  Shape() = default;
  explicit Shape(int side);
  Shape(int side, int other);
  virtual ~Shape() = default;
  virtual int pure() const = 0;
  virtual int by_its_table() const;
  int method_called() const;
  int method_never_called() const;
};
template <class T>
class Box {
 public:
  T box_called() const { return {}; }
  T box_never_called() const { return {}; }
};
struct ByConsumer {
  int used() const;
};
}  // namespace haarlight::made
"""

LIBRARY = """\
#include "haarlight/made/made.h"
namespace haarlight::made {
namespace {
int local(int value) { return called_by_a_local_one(value); }
}
int called(int value) { return called_by_a_called_one(value) + local(value); }
int called_by_a_called_one(int value) { return 3 * value; }
int called_by_a_local_one(int value) { return 4 * value; }
int never_called(int value) { return called_by_never_called(value); }
int called_by_never_called(int value) { return 5 * value; }
int overloaded(int value) { return 6 * value; }
int overloaded(double value) { return static_cast<int>(value); }
Shape::Shape(int) {}
Shape::Shape(int, int) {}
int Shape::by_its_table() const { return 7; }
int Shape::method_called() const { return 8; }
int Shape::method_never_called() const { return 9; }
int ByConsumer::used() const { return 10; }
}  // namespace haarlight::made
"""

PROGRAM = """\
#include "haarlight/made/made.h"
namespace made = haarlight::made;
class Square : public made::Shape {
 public:
  Square() : Shape(4) {}
  int pure() const override { return method_called(); }  // not inline_never_called
};
int main() {
  const Square square;
  return made::called(1) + made::overloaded(2) + made::inline_called(3) + made::template_called(4) +
         made::Box<int>().box_called() + square.pure() + made::ByConsumer().used();
}
"""

# Function, its line in the header.
UNREACHED = {
    ("never_called(int)", 6), ("called_by_never_called(int)", 7), ("overloaded(double)", 9),
    ("inline_never_called(int)", 11), ("template_never_called(T)", 15), ("Shape::Shape(int, int)", 20),
    ("Shape::method_never_called()", 25), ("Box::box_never_called()", 31)}


class Reached(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        place = tempfile.TemporaryDirectory(prefix="haarlight-reached.")
        cls.addClassCleanup(place.cleanup)
        cls.folder = pathlib.Path(place.name)
        header = cls.folder / "include/haarlight/made/made.h"
        header.parent.mkdir(parents=True)
        header.write_text(HEADER)
        library = cls.compiled("library.cpp", LIBRARY, "clang++", "-O1", "-fsanitize=fuzzer-no-link,address,undefined")
        program = cls.compiled("program.cpp", PROGRAM, "g++", "-O2")
        include = cls.folder / "include"
        cls.left = check_reached.unreached(
            check_reached.declared_functions(include), [header],
            check_reached.Libraries([library], lambda source: check_reached.compile_plainly(
                source, cls.folder, [f"-I{include}"])),
            check_reached.Programs([program[1]], [program[0]]))

    @classmethod
    def compiled(cls, name, text, compiler, *flags):
        source, made = cls.folder / name, cls.folder / f"{name}.o"
        source.write_text(text)
        subprocess.run([compiler, "-std=c++20", f"-I{cls.folder}/include", *flags, "-c", source, "-o", made], check=True)
        return source, made

    def test_what_no_program_reaches_is_named_with_its_line(self):
        self.assertEqual({(str(f).removeprefix("haarlight::made::"), f.line) for f in self.left}, UNREACHED)
        self.assertEqual({f.header for f in self.left}, {"haarlight/made/made.h"})

    def test_a_listed_function_is_no_problem_and_a_needless_entry_is_one(self):
        listed = {str(function): 1 for function in self.left}
        self.assertEqual(check_reached.problems_of(self.left, listed, "list"), [])
        problems = check_reached.problems_of(self.left, {**listed, "haarlight::made::called(int)": 7}, "list")
        self.assertEqual(len(problems), 1)
        self.assertTrue(problems[0].startswith("list:7: haarlight::made::called(int) is reached"), problems)
        self.assertEqual(len(check_reached.problems_of(self.left, {}, "list")), len(self.left))

    def test_an_entry_needs_a_reason(self):
        path = self.folder / "exceptions.txt"
        path.write_text("# a list\nhaarlight::made::called(int) — for others\n")
        self.assertEqual(check_reached.exceptions_of(path), {"haarlight::made::called(int)": 2})
        path.write_text("haarlight::made::called(int)\n")
        with self.assertRaises(SystemExit):
            check_reached.exceptions_of(path)


if __name__ == "__main__":
    unittest.main(verbosity=2)
