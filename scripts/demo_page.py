#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes out/demo/index.html from the pictures and reports beside it: demo_page.py FOLDER.

Shows only what is there and measured; a picture or report that is missing ends with an error.
"""

import html
import json
import pathlib
import sys

STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem;
       color: #222; background: #fafafa; }
h1 { margin-bottom: 0; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(15rem, 100%), 1fr)); gap: 1rem;
       margin: 1rem 0; }
.row.small { grid-template-columns: repeat(auto-fit, minmax(min(12rem, 100%), 1fr)); max-width: 40rem; }
.row.two { grid-template-columns: repeat(auto-fit, minmax(min(28rem, 100%), 1fr)); }
.turning { aspect-ratio: 4 / 3; background: url(hull_turning.png) 0 0 / 100% 1600%; margin-top: .3rem;
           animation: turn 6s steps(16) infinite; }
@keyframes turn { to { background-position: 0 106.6667%; } }
#turns:not(:checked) ~ .turning { animation-play-state: paused; }
@media (prefers-reduced-motion: reduce) { .turning { animation: none; } #turns, #turns + label { display: none; } }
.row.large { grid-template-columns: repeat(auto-fit, minmax(min(22rem, 100%), 1fr)); }
figure { margin: 0; background: #fff; border: 1px solid #ddd; padding: .5rem; }
figure img { width: 100%; background: #000; display: block; }
figcaption { font-size: .9rem; margin-top: .4rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { text-align: left; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid #ddd; }
th:not(:first-child) { text-align: right; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
code { background: #eee; padding: .1rem .3rem; }
summary { cursor: pointer; font-weight: bold; }
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

    def command(self, text: str) -> None:
        self.parts.append(f"<p><code>{html.escape(text)}</code></p>")

    def pictures(self, rows: list[tuple[str, str]], kind: str = "row") -> None:
        self.parts.append(f'<div class="{kind}">')
        for name, caption in rows:
            if not (self.folder / name).is_file():
                raise FileNotFoundError(self.folder / name)
            self.parts.append(f'<figure><img src="{name}" alt="{html.escape(caption)}">'
                              f"<figcaption>{html.escape(caption)}</figcaption></figure>")
        self.parts.append("</div>")

    def table(self, head: list[str], rows: list[list[str]]) -> None:
        cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
        self.parts.append(f'<div class="scroll"><table><tr>{cells}</tr>')
        for row in rows:
            first, rest = row[0], row[1:]
            self.parts.append("<tr><td>" + html.escape(first) + "</td>" + "".join(
                f'<td class="number">{html.escape(cell)}</td>' for cell in rest) + "</tr>")
        self.parts.append("</table></div>")

    def write(self) -> None:
        body = "\n".join(self.parts)
        text = ("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
                "<meta name=\"viewport\" content=\"width=device-width\">"
                "<link rel=\"icon\" href=\"data:,\">"
                f"<title>haarlight: the demo</title><style>{STYLE}</style></head>\n"
                f"<body>\n{body}\n</body></html>\n")
        temporary = self.folder / "index.html.tmp"
        temporary.write_text(text, encoding="utf-8")
        temporary.rename(self.folder / "index.html")


def percent(fraction: float) -> str:
    return f"{100 * fraction:.1f} %"


def relit_row(page: Page, name: str, caption: str) -> list[str]:
    report = page.report(name)
    reached, details = report["reached"], report["details"]
    return [caption, number(reached["terms"]), number(details["terms_all"]),
            number(reached["relative_l2_bound"]), number(reached["clipped_share"]),
            number(1e3 * details["relight_seconds"])]


def shadow_row(page: Page, name: str, caption: str) -> list[str]:
    reached = page.report(name)["reached"]
    return [caption, percent(reached["shadow_wrong_share"]), number(reached["relative_l2"]),
            number(reached["psnr_db"]), percent(reached["known_share"]),
            percent(reached["shadow_wrong_share_where_known"])]


LIGHTINGS = [("painted", "painted light, in colour"), ("room", "a room, as a high-dynamic-range environment"),
             ("one", "one light"), ("four", "four lights")]
SHADOWS = [("shadow_four", "four lights"), ("shadow_room", "the room")]


def show_shadows(page: Page) -> None:
    page.heading("Its shadow on stairs", "The shadow that the camera saw on the plane, cast on steps below, on and above "
                 "it. The plane's pictures alone do not show what the object hid from the camera, what fell beyond "
                 "the picture, or what lies above the plane. The hull, carved from the same pictures, does. "
                 "Nothing about the object's geometry is used but for the truth, which is ray-traced with it.")
    for name, caption in SHADOWS:
        wrong = percent(page.report(name)["reached"]["shadow_wrong_share"])
        plane = page.folder / f"{name}_plane.png"
        before = [(plane.name, f"{caption}, from the plane's pictures alone")] if plane.is_file() else []
        page.pictures([*before, (f"{name}.png", f"{caption}, with the hull: {wrong} of the shadow is wrong"),
                       (f"{name}_truth.png", f"{caption}, the truth: ray-traced")])
        page.pictures([(f"{name}_difference.png",
                        f"{caption}, with the hull: absolute difference from the truth, four times brighter")],
                      "row small")


def show_hull(page: Page) -> None:
    reached = page.report("hull")["reached"]
    page.heading("The hull", "The largest object that the shadows allow, carved out of the same pictures: it turns here beside "
                 "the views of the camera, from the front, from the right and from above. Orange: assumed, since less than "
                 "three quarters of the lights saw it.")
    if not (page.folder / "hull_turning.png").is_file():
        raise FileNotFoundError(page.folder / "hull_turning.png")
    page.parts.append('<div class="row two"><figure><input type="checkbox" id="turns" checked>'
                      '<label for="turns">turn</label><div class="turning" role="img" aria-label="the hull, turning"></div>'
                      f'<figcaption>{number(round(1e-3 * reached["volume_mm3"]))} cm³ within what no shadow contradicts'
                      '</figcaption></figure><figure><img src="hull.png" alt="the hull from four sides">'
                      '<figcaption>by the camera, from the front, from the right, from above</figcaption></figure></div>')
    page.command(f"./haarlight hull out/{page.folder.name}/biplane.hlb -o hull.ply")


def show_sky(page: Page) -> None:
    page.heading("Under a sky", "The relit object with its shadow on a plinth that was never there, seen by the capture's "
                 "camera. Behind it the environment that lights it, out of focus by one degree.")
    page.pictures([("standing.png", f'{percent(page.report("standing")["details"]["background_share"])} of the picture shows '
                    "the environment; the plinth is a scene file")])


def show_pictures(page: Page) -> None:
    page.parts.append("<p>One capture of a virtual rig: a toy biplane under each of 32 × 32 lights, by a colour camera of "
                      "480 × 360 pixels. All the lights below were never on together. Drag, paint and rotate the light "
                      "yourself:</p>")
    page.command(f"./haarlight view out/{page.folder.name}/biplane.hlb")
    page.pictures([(f"{name}.png", caption) for name, caption in LIGHTINGS], "row two")
    show_shadows(page)
    show_hull(page)
    show_sky(page)
    if (page.folder / "door.hlb").exists():
        page.heading("A real object", "A painted wooden door, photographed under 60 single lights (Accademia "
                     "di Belle Arti di Verona; RealRTI, github.com/Univr-RTI/RealRTI), under two skies "
                     "(Poly Haven).")
        page.pictures([("door_photo.jpg", "one of the photographs"),
                       ("door_apartment.png", "in an apartment"),
                       ("door_venice.png", "in Venice, at sunset")], "row large")


def show_figures(page: Page) -> None:
    page.parts.append("<h2>Figures</h2><p>They all come from the reports next to this page.</p>")
    capture, verify = page.report("capture"), page.report("verify")
    compress = page.report("compress")
    page.heading("Captured", "One picture per light, by the daemon over Modbus TCP and a camera socket. Every "
                 "frame carries the controller's tag.")
    page.table(["", "figure"], [
        ["lights captured, each frame with its own light's tag", f'{verify["reached"]["good_frames"]} of {verify["reached"]["shots"]}'],
        ["problems found when all evidence was rechecked",
         number(verify["reached"]["problems"])],
        ["camera frames that it took", number(capture["reached"]["frames"])],
        ["seconds", number(capture["seconds"])],
    ])
    page.heading("Compressed", "Haar wavelets over the lights, after the clean plate was subtracted.")
    page.table(["", "figure"], [
        ["relative error requested", number(compress["asked"].get("relative_l2"))],
        ["relative error achieved", number(compress["reached"].get("relative_l2"))],
        ["worst pixel's relative error", number(compress["reached"]["worst_pixel"])],
        ["worst value's error, fraction of the peak", number(compress["reached"]["worst_value"])],
        ["values clipped in every exposure: lower bounds, covered by no error on this page",
         number(compress["reached"]["clipped_values"])],
        ["the norm of these, at least, as a fraction of the whole",
         number(compress["reached"]["clipped_least_norm"])],
        ["bytes", number(compress["bytes"])],
        ["seconds", number(compress["seconds"])],
    ])
    page.heading("Relit", "The biplane's pictures.")
    page.table(["", "terms used", "of", "error at most", "fraction of the values clipped", "ms"],
               [relit_row(page, name, caption) for name, caption in LIGHTINGS])
    page.heading("Shadows", "Against the ray-traced pictures.")
    page.table(["", "shadow wrong", "relative error", "PSNR, dB",
                "receivers that look at known points only", "shadow wrong there"],
               [shadow_row(page, name, caption) for name, caption in SHADOWS])


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: demo_page.py FOLDER", file=sys.stderr)
        return 2
    page = Page(pathlib.Path(sys.argv[1]).resolve())
    page.parts.append("<h1>haarlight</h1><p>Photograph an object under every light of a rig, then show it under "
                      "any light.</p>")
    show_pictures(page)
    show_figures(page)
    page.write()
    return 0


if __name__ == "__main__":
    sys.exit(main())
