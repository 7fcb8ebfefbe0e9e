#!/usr/bin/env python3
"""Writes out/demo/index.html from the pictures and reports beside it: demo_page.py FOLDER.

Shows only what is there and measured; a picture or report that is missing ends with an error.
"""

import html
import json
import pathlib
import sys

STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem;
       color: #222; background: #fafafa; }
h1 { margin-bottom: 0; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(15rem, 1fr)); gap: 1rem; }
figure { margin: 0; background: #fff; border: 1px solid #ddd; padding: .5rem; }
figure img { width: 100%; image-rendering: auto; background: #000; display: block; }
figcaption { font-size: .9rem; margin-top: .4rem; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { text-align: left; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid #ddd; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
"""


def number(value, digits: int = 3) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    return f"{value:,}".replace(",", " ")


class Page:
    def __init__(self, folder: pathlib.Path):
        self.folder = folder
        self.parts = []

    def report(self, name: str) -> dict:
        return json.loads((self.folder / f"{name}.json").read_text(encoding="utf-8"))

    def heading(self, text: str, note: str) -> None:
        self.parts.append(f"<h2>{html.escape(text)}</h2>\n<p>{html.escape(note)}</p>")

    def pictures(self, rows: list[tuple[str, str]]) -> None:
        self.parts.append('<div class="row">')
        for name, caption in rows:
            if not (self.folder / name).is_file():
                raise FileNotFoundError(self.folder / name)
            self.parts.append(f'<figure><img src="{name}" alt="{html.escape(caption)}">'
                              f"<figcaption>{html.escape(caption)}</figcaption></figure>")
        self.parts.append("</div>")

    def table(self, head: list[str], rows: list[list[str]]) -> None:
        cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
        self.parts.append(f"<table><tr>{cells}</tr>")
        for row in rows:
            first, rest = row[0], row[1:]
            self.parts.append("<tr><td>" + html.escape(first) + "</td>" + "".join(
                f'<td class="number">{html.escape(cell)}</td>' for cell in rest) + "</tr>")
        self.parts.append("</table>")

    def write(self) -> None:
        body = "\n".join(self.parts)
        text = ("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
                "<meta name=\"viewport\" content=\"width=device-width\">"
                f"<title>haarlight: the demo</title><style>{STYLE}</style></head>\n"
                f"<body>\n{body}\n</body></html>\n")
        temporary = self.folder / "index.html.tmp"
        temporary.write_text(text, encoding="utf-8")
        temporary.rename(self.folder / "index.html")


def relit_row(page: Page, name: str, caption: str) -> list[str]:
    report = page.report(name)
    reached, details = report["reached"], report["details"]
    return [caption, number(reached["terms"]), number(details["terms_all"]),
            number(reached["relative_l2_bound"]), number(reached["relative_l2"]),
            number(reached["clipped_share"]),
            number(1e3 * details["relight_seconds"])]


def shadow_row(page: Page, name: str, caption: str) -> list[str]:
    reached = page.report(name)["reached"]
    return [caption] + [number(reached[key]) for key in (
        "relative_l2", "psnr_db", "shadow_wrong_share", "known_share",
        "relative_l2_where_known", "shadow_wrong_share_where_known")]


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: demo_page.py FOLDER", file=sys.stderr)
        return 2
    page = Page(pathlib.Path(sys.argv[1]))
    page.parts.append("<h1>haarlight</h1><p>One virtual capture, made and judged on this machine. "
                      "Every figure comes from the reports beside this page.</p>")
    capture, verify = page.report("capture"), page.report("verify")
    compress = page.report("compress")
    page.heading("Captured", "A 32 × 32 LED array, one picture a light, by the real daemon over "
                 "Modbus TCP and a camera socket. Every frame carries the controller's tag.")
    page.table(["", "figure"], [
        ["lights captured, each frame with its own light's tag", f'{verify["reached"]["good_frames"]} of {verify["reached"]["shots"]}'],
        ["problems found when all evidence was checked again",
         number(verify["reached"]["problems"])],
        ["camera frames that it took", number(capture["reached"]["frames"])],
        ["seconds", number(capture["seconds"])],
    ])
    page.heading("Compressed", "Haar wavelets over the lights, less the clean plate.")
    page.table(["", "figure"], [
        ["relative error asked", number(compress["asked"].get("relative_l2"))],
        ["relative error reached", number(compress["reached"].get("relative_l2"))],
        ["worst pixel's relative error", number(compress["reached"]["worst_pixel"])],
        ["worst value's error, share of the peak", number(compress["reached"]["worst_value"])],
        ["values clipped in every exposure: lower bounds, in no error on this page",
         number(compress["reached"]["clipped_values"])],
        ["the norm of these, at least, as a share of the whole",
         number(compress["reached"]["clipped_least_norm"])],
        ["bytes", number(compress["bytes"])],
        ["seconds", number(compress["seconds"])],
    ])
    page.heading("Relit", "The same capture under lights that were never lit together.")
    names = [("one", "one light"), ("four", "four lights"), ("nine", "nine lights"),
             ("room", "a room, as a high-dynamic-range environment")]
    page.pictures([(f"{name}.png", caption) for name, caption in names])
    page.table(["", "terms used", "of", "error at most", "error against the raw capture",
                "share of the values clipped", "ms"],
               [relit_row(page, name, caption) for name, caption in names])
    page.heading("Its shadow on stairs", "The captured shadow on steps below, on and above the "
                 "plane where it was captured, beside the ray-traced truth. What the object hid from "
                 "the camera is unknown and drawn as the middle of dark and lit.")
    shadows = [("shadow_four", "four lights"), ("shadow_room", "the room")]
    for name, caption in shadows:
        page.pictures([
            (f"{name}.png", f"{caption}: from the capture, no geometry of the object used"),
            (f"{name}_truth.png", f"{caption}: ray-traced with the object's geometry"),
            (f"{name}_difference.png", "absolute difference, four times brighter")])
    page.table(["", "relative error", "PSNR, dB", "share of the shadow that is wrong",
                "receivers that look at known places only", "relative error there",
                "share of the shadow that is wrong there"],
               [shadow_row(page, name, caption) for name, caption in shadows])
    page.write()
    return 0


if __name__ == "__main__":
    sys.exit(main())
