#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""scripts/check_docs.py finds every word of its table where somebody would write it, leaves the same letters alone where
they mean something else, and finds dead links. words_test.py needs nothing built."""

import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent.parent / "scripts"))
import check_docs  # noqa: E402

# For each rule, prose that it must find.
PLANTED = {
    "stamp": ["The stamp decides.", "two time stamps", "It stamps the end."],
    "tag rows": ["The tag rows are below.", "one tag row"],
    "share": ["A share of the peak is lost.", "the clipped share", "in shares of the range"],
    "place": ["The light's place is known.", "Names file, place and line.", "places from several balls"],
    "judge": ["The frame is judged.", "It judges each one."],
    "recipe": ["One recipe for all."],
    "hurry": ["the hurry of a retry"],
    "gossip": ["It is gossip."],
    "house": ["An unhoused buffer.", "the plan of the house"],
    "desk": ["The desk answers."],
    "person": ["For the person at the rig."],
    "cure": ["Names the cause and the cure.", "It is cured by a restart."],
    "drives": ["Under the drives w.", "a list of drives", "at drive 1", "A picture of drives."],
    "put out": ["It puts all lights out.", "The lights are put out."],
    "asked/reached": ["The error reached is small.", "what was asked", "the region asked"],
    "large buffer": ["A LargeBuffer is mapped."],
    "knot": ["Knots on a grid."],
    "a light": ["One weight a light.", "32 coefficients a pixel", "bytes a pixel", "one a light", "A number a frame."],
    "plate": ["The plate is taken off."],
}

# What the rules must not find.
LEGITIMATE = [
    "The faces share a bus, and what they share is written down.", "All lights share one pose.", "`share/` and /usr/share/doc",
    "It is done in place and takes place at once; the file takes its place.", "Three decimal places.", "In the first place.",
    "Place the sheet under the camera.", "The controller drives the LEDs.", "Two USB drives.", "Its `cure` key.",
    "A timestamp.", "Put it there.", "The daemon cannot be reached.", "It is asked for the token.",
    "30 frames a second", "one at a time", "Which bytes a plane uses.", "The gains: a light's three.", "At 0.048 a picture loses 3 dB.",
    "A link in its place lets it go on.", 'The form {"error": {"cure": "text"}}.', "It takes a light.", "2 in a row", "Read a frame.", "--places positions",
    "https://example.org/the/place/of/judges", "[a page](the/share/of.md)", "A clean plate, then the plate.",
]


def found(text, name):
    return {rule for _, rule, _, _ in check_docs.words_in(text, pathlib.Path(name))}


class Words(unittest.TestCase):
    def test_every_rule_has_planted_words(self):
        self.assertEqual(set(PLANTED), {name for name, *_ in check_docs.WORDS} | {"plate"})

    def test_planted_words_are_found_in_every_kind_of_text(self):
        for rule, texts in PLANTED.items():
            for text in texts:
                with self.subTest(rule=rule, text=text):
                    self.assertIn(rule, found(f"# A title\n\n{text}\n", "docs/page.md"))
                    if rule == "plate":  # of documents only
                        continue
                    self.assertIn(rule, found(f"int a;  // {text}\n", "core/a.cpp"))
                    self.assertIn(rule, found(f'fail("there: {text}");\n', "core/a.cpp"))
                    self.assertIn(rule, found(f"/// {text}\nint a;\n", "core/a.h"))
                    self.assertIn(rule, found(f"x = 1  # {text}\n", "scripts/a.py"))
                    self.assertIn(rule, found(f'"""{text}"""\n', "scripts/a.py"))
                    self.assertIn(rule, found(f"say(`now: {text}`);\n", "web/a.js"))
                    self.assertIn(rule, found(f"level = 1  # {text}\n", "configs/a.toml"))
                    self.assertIn(rule, found(f'{{"description": "now: {text}"}}\n', "docs/a.json"))
                    self.assertIn(rule, found(f"<p class='x'>{text}</p>\n", "web/a.html"))

    def test_words_are_found_across_lines(self):
        self.assertIn("a light", found("One weight\na light.\n", "docs/page.md"))
        self.assertIn("a light", found("/// One weight a\n/// light.\n", "core/a.h"))
        self.assertIn("put out", found("# It puts the lights\n# out.\n", "scripts/a.py"))

    def test_the_line_is_told(self):
        self.assertEqual(list(check_docs.words_in("# A\n\nGood.\nOne\nrecipe.\n", pathlib.Path("a.md")))[0][:3],
                         (5, "recipe", "recipe"))

    def test_other_meanings_are_left_alone(self):
        for text in LEGITIMATE:
            with self.subTest(text=text):
                self.assertEqual(found(f"{text}\n", "docs/page.md"), set())
                self.assertEqual(found(f"/// {text}\n", "core/a.h"), set())

    def test_keys_code_and_commands_are_left_alone(self):
        self.assertEqual(found("    haarlight relight --light 1 a light\n    share = 0.1\n", "docs/page.md"), set())
        self.assertEqual(found("```toml\n[late_light]\nshare = 0.1\nplace = 2\n```\n", "docs/page.md"), set())
        self.assertEqual(found('json["cure"] = place.at("drives");\n', "core/a.cpp"), set())
        self.assertEqual(found('R"(\nshare = 0.1\nplace = 2\n)"\n', "core/a.cpp"), set())

    def test_links_lead_to_headings(self):
        page = check_docs.ROOT / "docs/reference/sync-modes.md"
        self.assertTrue(check_docs.leads_somewhere(page, "whether-a-timestamp-is-believed"))
        self.assertTrue(check_docs.leads_somewhere(page, ""))
        self.assertFalse(check_docs.leads_somewhere(page, "no-such-heading"))
        self.assertFalse(check_docs.leads_somewhere(page.with_name("no-such-page.md"), ""))
        self.assertEqual(list(check_docs.problems_of("README.md", "[a](docs/README.md#no-such-heading)", set())),
                         ["README.md:1: link to docs/README.md#no-such-heading leads nowhere"])
        self.assertEqual(list(check_docs.unlisted()), [])

    def test_names_in_code_follow(self):
        self.assertIn("recipe in a name", found("auto made = read_recipe(file);\n", "core/a.cpp"))
        self.assertIn("judge in a name", found("def judge(x):\n", "scripts/a.py"))
        self.assertEqual(found("const kNothing = 1; desktop(1);\n", "web/a.js"), set())


if __name__ == "__main__":
    unittest.main(verbosity=2)
