# SPDX-License-Identifier: Apache-2.0
"""What is in the exact-image suite: bodies, fields, meshes and scenes. Coefficients of fields are binary fractions."""

from fractions import Fraction as F

import cube_meshes as cm
from cell_kinds import KINDS

# ---- bodies: planes (normal, offset) at which a ray may enter or leave, and which points are inside -----


class Boxes:
    """All that is in one of the boxes, but not in the hole; each (low, high)."""

    def __init__(self, *boxes, hole=None):
        self.boxes, self.hole = boxes, hole
        self.planes = [(tuple(int(i == axis) for i in range(3)), end[axis])
                       for box in (*boxes, *([hole] if hole else [])) for end in box for axis in range(3)]

    @staticmethod
    def is_in(p, box):
        return all(low < c < high for low, c, high in zip(box[0], p, box[1]))

    def contains(self, p):
        return any(self.is_in(p, box) for box in self.boxes) and not (self.hole and self.is_in(p, self.hole))


class Sheared:
    """The unit cube under cube_meshes.sheared()."""

    planes = [((0, 0, 1), 0), ((0, 0, 1), 1), ((0, 1, -0.25), 0), ((0, 1, -0.25), 1),
              ((1, -0.25, -0.0625), 0), ((1, -0.25, -0.0625), 1)]

    def contains(self, p):
        y = p[1] - p[2] / 4
        return all(0 < c < 1 for c in (p[0] - y / 4 - p[2] / 8, y, p[2]))


CUBE = ((0, 0, 0), (1, 1, 1))
BESIDE = ((1, 0.5, 0.25), (2, 1.5, 1.25))
APART = ((1.5, 0.25, 0.5), (2.5, 1.25, 1.5))
BODIES = {
    "cube": Boxes(CUBE),
    "with_hole": Boxes(CUBE, hole=((0.25, 0.25, 0.25), (0.75, 0.75, 0.75))),
    "apart": Boxes(CUBE, APART),
    "beside": Boxes(CUBE, BESIDE),
    "sheared": Sheared(),
}

# ---- fields: {(i, j, k): coefficient of x^i y^j z^k}, and those that are constant in each cell ------------

X, Y, Z, ONE = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)
FIELDS = {
    "linear": {X: F(1, 8), Y: F(1, 4), Z: F(1, 2), ONE: F(1, 16)},  # 1/16 ... 15/16 in the cube
    "other": {X: F(1, 2), Y: F(-1, 4), Z: F(1, 8), ONE: F(5, 16)},  # 1/16 ... 15/16
    "products": {(1, 1, 0): F(1, 4), (0, 1, 1): F(1, 2), (1, 0, 1): F(-1, 4), X: F(1, 4), ONE: F(1, 8)},
    "product": {(1, 1, 1): F(7, 8), ONE: F(1, 16)},
    "quadratic": {(2, 0, 0): F(-3, 4), (0, 2, 0): F(-1, 2), (0, 0, 2): F(-1), (1, 1, 0): F(1, 4), (0, 1, 1): F(-1, 8),
                  X: F(5, 8), Y: F(9, 16), Z: F(1), ONE: F(5, 16)},
}


class Layers:
    """Of 4 x 4 x 4 boxes, each with a value of its own."""

    planes = [(tuple(int(i == axis) for i in range(3)), n / 4) for axis in range(3) for n in range(5)]

    def value(self, p):
        i, j, k = (int(4 * c) for c in p)
        return F((5 * i + 3 * j + 7 * k + i * j) % 8, 8)


class SixParts:
    """Of the six tetrahedra of a cube, by which coordinate is larger."""

    planes = [((1, -1, 0), 0), ((0, 1, -1), 0), ((1, 0, -1), 0)]

    def value(self, p):
        return F(1, 8) + F(int(p[0] > p[1]), 2) + F(int(p[1] > p[2]), 4) + F(int(p[0] > p[2]), 8)


CELL_FIELDS = {"layers": Layers(), "six_parts": SixParts()}


def scattered(p):
    """A number of its own for each node, from 0 to 1."""
    seed = int(4096 * (p[0] + 5 * p[1] + 11 * p[2]))
    for _ in range(3):
        seed = (1103515245 * seed + 12345) % 2**31
    return F((seed >> 12) % 65, 64)


NODE_FIELDS = {"random": scattered, "random_other": lambda p: scattered(cm.plus(p, (3, 2, 1)))}

# ---- meshes --------------------------------------------------------------------------------------


def mesh(cells, *fields, body="cube", cell_fields=()):
    return {"cells": cells, "fields": fields or ("linear",), "body": body, "cell_fields": cell_fields}


def tetrahedra_apart():
    return cm.cube(2, cm.five_tetrahedra) + cm.box(*APART, (1, 2, 1), cm.two_wedges)


def hexahedra_beside():
    return cm.cube(2, cm.one_hexahedron) + cm.box(*BESIDE, (1, 2, 2), cm.six_tetrahedra)


def with_hole():
    return cm.cube(4, cm.six_tetrahedra, is_there=lambda index: not all(i in (1, 2) for i in index))


def raised(kind, cells):
    return cm.raised(kind, KINDS[kind].between(), cells)


def bent(kind, counts, divide):
    """The unit cube's boxes in cells of a kind all of whose nodes are moved."""
    return lambda: cm.moved(raised(kind, cm.box(*CUBE, counts, divide)), lambda p: cm.bent_about(p, F(1, 32), across=True))


MESHES = {
    "five": mesh(lambda: cm.cube(1, cm.five_tetrahedra)),
    "six": mesh(lambda: cm.cube(1, cm.six_tetrahedra), "linear", "other", cell_fields=("six_parts",)),
    "five_8": mesh(lambda: cm.cube(2, cm.five_tetrahedra)),
    "six_27": mesh(lambda: cm.cube(4, cm.six_tetrahedra)),
    "irregular": mesh(lambda: cm.moved(cm.cube(4, cm.six_tetrahedra), cm.jittered), "linear", "other"),
    "one_hexahedron": mesh(lambda: cm.cube(1, cm.one_hexahedron), "linear", "product"),
    "hexahedra": mesh(lambda: cm.cube(2, cm.one_hexahedron), "linear", "products"),
    "layers": mesh(lambda: cm.cube(4, cm.five_tetrahedra), cell_fields=("layers",)),
    "layers_of_hexahedra": mesh(lambda: cm.cube(4, cm.one_hexahedron), cell_fields=("layers",)),
    "sheared": mesh(lambda: cm.moved(cm.cube(2, cm.one_hexahedron), cm.sheared), body="sheared"),
    "wedges": mesh(lambda: cm.cube(2, cm.two_wedges)),
    "pyramids": mesh(lambda: cm.cube(2, cm.six_pyramids)),
    "mixed": mesh(cm.mixed),
    "quadratic": mesh(lambda: cm.cube(2, cm.six_quadratic_tetrahedra), "linear", "quadratic"),
    "quadratic_six": mesh(lambda: cm.cube(1, cm.six_quadratic_tetrahedra), "quadratic"),
    "random": mesh(lambda: cm.moved(cm.cube(4, cm.six_tetrahedra), cm.jittered), "random", "random_other"),
    "random_quadratic": mesh(lambda: cm.cube(2, cm.six_quadratic_tetrahedra), "random"),
    "bent": mesh(lambda: cm.moved(cm.cube(2, cm.six_quadratic_tetrahedra), cm.bent_inside)),
    "random_bent": mesh(lambda: cm.moved(cm.cube(2, cm.six_quadratic_tetrahedra), cm.bent_everywhere), "random", "random_other"),
    "cubic": mesh(lambda: raised(cm.CUBIC_TETRAHEDRON, cm.box((0, 0, 0), 3 * (F(3, 4),), (1, 1, 1), cm.six_tetrahedra)), "random"),
    "bent_hexahedra": mesh(bent(cm.QUADRATIC_HEXAHEDRON, (2, 1, 1), cm.one_hexahedron), "random", "random_other"),
    "bent_wedges": mesh(bent(cm.QUADRATIC_WEDGE, (1, 1, 1), cm.two_wedges), "random", "random_other"),
    "bent_pyramids": mesh(bent(cm.QUADRATIC_PYRAMID, (1, 1, 1), cm.six_pyramids), "random", "random_other"),
    "tapered_hexahedra": mesh(lambda: cm.moved(cm.cube(2, cm.one_hexahedron), cm.tapered), "random"),
    "tapered_wedges": mesh(lambda: cm.moved(cm.cube(2, cm.two_wedges), cm.tapered), "random", "random_other"),
    "tapered_pyramids": mesh(lambda: cm.moved(cm.cube(1, cm.six_pyramids), cm.tapered), "random"),
    "with_hole": mesh(with_hole, body="with_hole"),
    "apart": mesh(tetrahedra_apart, body="apart"),
    "beside": mesh(hexahedra_beside, body="beside"),
}

# ---- transfer functions and cameras --------------------------------------------------------------

HILLS = ((0.0, 0.25), (0.3, 4.5), (0.55, 0.5), (0.8, 5.0), (1.0, 1.0))
COLOURS = ((0.0, 0.1, 0.2, 0.9), (0.3, 0.9, 0.1, 0.2), (0.55, 0.2, 0.9, 0.3), (0.8, 1.0, 0.9, 0.1), (1.0, 0.3, 0.3, 1.0))
SPIKES = ((0.0, 0.0), (0.25, 0.0), (0.3, 20.0), (0.35, 0.0), (0.65, 0.0), (0.7, 20.0), (0.75, 0.0))
TWO_COLOURS = ((0.0, 0.2, 0.4, 1.0), (1.0, 1.0, 0.6, 0.1))
NEARLY_CONSTANT = ((0.0, 1.0), (1.0, 1.0000003))
TWELVE = tuple((n / 13, (0.5, 6.0, 1.5, 3.0)[n % 4]) for n in range(1, 13))
TWELVE_COLOURS = tuple(((n + 0.4) / 13, (n % 3) / 2, (n % 4) / 3, (n % 5) / 4) for n in range(1, 13))


def contour(value, colour, opacity, ambient=0.2, diffuse=0.7, specular=0.3, exponent=30.0):
    return {"value": value, "colour": colour, "opacity": opacity, "ambient": ambient, "diffuse": diffuse, "specular": specular,
            "exponent": exponent}


PANES = (contour(0.3, (0.9, 0.2, 0.1), 0.8), contour(0.5, (0.9, 0.8, 0.2), 0.4), contour(0.7, (0.2, 0.5, 0.9), 0.3, 0.1, 0.8, 0.5, 12.0))


def view(size, **words):
    """The cube from outside; `words` win."""
    camera = {"size": size, "eye": (1.9, 2.2, 3.1), "target": (0.5, 0.5, 0.5), "fov_y_deg": 31.0, **words}
    if "width_mm" in camera:
        del camera["fov_y_deg"]
    return camera


def along_z(size, focal, eye):
    """Towards +z with the world's axes as the camera's; every number is exact."""
    return {"size": size, "K": ((focal, 0.0, size[0] / 2), (0.0, focal, size[1] / 2), (0.0, 0.0, 1.0)),
            "world_from_cam": tuple((*(float(i == j) for j in range(3)), eye[i]) for i in range(3))}


def scene(note, mesh_name, camera, density=HILLS, colour=COLOURS, field="linear", **words):
    return {"note": note, "mesh": mesh_name, "camera": camera, "density": density, "colour": colour, "field": field, **words}


NEAR = view((9, 9), fov_y_deg=19.0)  # within the cube's outline
PARALLEL = {"eye": (3.0, -1.5, 2.5), "width_mm": 1.875}
SCENES = {
    "five_tetrahedra": scene("The cube in five tetrahedra; in perspective.", "five", view((24, 24))),
    "six_tetrahedra": scene("In six tetrahedra; parallel, glow of its own.", "six", view((25, 25), **PARALLEL), glow="own"),
    "irregular_tetrahedra": scene("In 384 irregular tetrahedra.", "irregular", view((35, 33))),
    "hexahedra": scene("In eight hexahedra, linear field.", "hexahedra", view((24, 24))),
    "hexahedra_products": scene("In eight hexahedra, products of two coordinates: quadratic along a ray.", "hexahedra",
                                view((24, 24)), field="products", glow="own"),
    "hexahedron_product": scene("In one hexahedron, the product of three coordinates: cubic along a ray.", "one_hexahedron",
                                view((25, 24), **PARALLEL), field="product"),
    "hexahedra_sheared": scene("Eight parallelepipeds.", "sheared", view((24, 24), target=(0.7, 0.6, 0.5), fov_y_deg=32.0)),
    "wedges": scene("In 16 wedges; parallel.", "wedges", view((24, 25), **PARALLEL)),
    "pyramids": scene("In 48 pyramids; glow of its own.", "pyramids", view((24, 24), eye=(-1.5, 2.0, -1.2)), glow="own"),
    "mixed": scene("Hexahedra, wedges, pyramids and tetrahedra whose faces meet only in part.", "mixed", view((32, 32))),
    "quadratic": scene("A quadratic field in 48 tetrahedra of ten nodes.", "quadratic", view((32, 32)), field="quadratic"),
    "quadratic_spikes": scene("A quadratic field with spikes of the density, six cells; parallel, glow of its own.",
                              "quadratic_six", view((25, 25), **PARALLEL), SPIKES, TWO_COLOURS, "quadratic", glow="own",
                              colour_scale=4.0),
    "spikes": scene("Two spikes of the density within one cell: the medium glows in two thin sheets.", "five", view((32, 32)),
                    SPIKES, TWO_COLOURS),
    "twelve_breakpoints": scene("Twelve breakpoints of the density and twelve of the colour in one cell.", "one_hexahedron",
                                view((24, 24), eye=(-1.6, -1.1, 2.4)), TWELVE, TWELVE_COLOURS),
    "nearly_constant": scene("A density that changes by three ten-millionths.", "six", view((24, 24)), NEARLY_CONSTANT, TWO_COLOURS),
    "along_z": scene("Parallel to an axis: all rays run in faces, along edges, through vertices.", "six_27",
                     {"size": (33, 33), "eye": (0.5, 0.5, 3.0), "target": (0.5, 0.5, 0.5), "up": (0.0, 1.0, 0.0),
                      "width_mm": 1.03125}),
    "along_z_perspective": scene("In perspective along an axis: many rays run in faces, one along edges.", "five_8",
                                 along_z((33, 33), 40.0, (0.5, 0.5, -1.0))),
    "along_diagonal": scene("Parallel to the cube's diagonal, along edges of all six tetrahedra.", "six_27",
                            {"size": (25, 25), "eye": (2.5, 2.5, 2.5), "target": (0.5, 0.5, 0.5), "width_mm": 1.875}),
    "eye_in_cell": scene("The eye is within a cell.", "irregular",
                         {"size": (25, 25), "eye": (0.41, 0.53, 0.37), "target": (0.31, 0.57, 0.63), "fov_y_deg": 100.0}),
    "eye_at_vertex": scene("The eye is at a vertex inside; many rays run in faces and along edges.", "five_8",
                           along_z((25, 25), 8.0, (0.5, 0.5, 0.5))),
    "eye_at_corner": scene("The eye is at the cube's corner.", "six_27", along_z((25, 25), 8.0, (0.0, 0.0, 0.0))),
    "clipped": scene("Near and far clipping in perspective.", "pyramids", view((24, 24), near_mm=2.875, far_mm=3.625)),
    "clipped_at_faces": scene("Parallel to an axis, clipped where faces of cells are.", "hexahedra",
                              {"size": (24, 24), "eye": (0.5, 0.5, 3.0), "target": (0.5, 0.5, 0.5), "up": (0.0, 1.0, 0.0),
                               "width_mm": 1.25, "near_mm": 2.25, "far_mm": 2.5}),
    "cell_field": scene("A field that is constant in each of 320 tetrahedra.", "layers", view((32, 32)), field="layers"),
    "cell_field_hexahedra": scene("A field that is constant in each of 64 hexahedra.", "layers_of_hexahedra", view((24, 24)),
                                  field="layers"),
    "cell_density": scene("The density by cell, the colour by point.", "six", view((24, 24), **PARALLEL), field="six_parts",
                          colour_field="linear"),
    "cell_colour": scene("The density by point, the colour by cell, glow of its own.", "six", view((24, 24)), field="linear",
                         colour_field="six_parts", glow="own"),
    "two_fields": scene("Density and colour by different fields.", "irregular", view((24, 24)), colour_field="other"),
    "background": scene("Thin, before a background.", "six", view((24, 24)), density_scale=0.25, background=(0.3, 0.5, 0.7)),
    "opaque_1e3": scene("Optical depths of some thousand; glow of its own.", "six", view((25, 25), **PARALLEL), density_scale=1024.0,
                        colour_scale=1024.0, glow="own"),
    "opaque_1e12": scene("Optical depths of some 10^12.", "irregular", view((24, 24)), density_scale=1e12,
                         background=(0.3, 0.5, 0.7)),
    "thin": scene("Optical depths of some 10^-12: errors count relative to the pixel.", "six", view((25, 25), **PARALLEL),
                  density_scale=1e-12),
    "contours": scene("Three semi-transparent contours of a linear field in a medium.", "six", view((25, 25)), contours=PANES,
                      contour_field="linear", density_scale=0.25),
    "contours_alone": scene("Contours of a quadratic field before a background, no medium; parallel.", "quadratic",
                            view((25, 25), **PARALLEL), ((0.0, 0.0),), field="linear", contours=PANES, contour_field="quadratic",
                            background=(0.3, 0.5, 0.7)),
    "contours_of_another": scene("Contours of a quadratic field, one of them opaque, in a medium of a linear one.", "quadratic",
                                 view((25, 25), eye=(-1.5, 2.0, 2.2)), field="linear",
                                 contours=(*PANES[:2], contour(0.8, (0.2, 0.5, 0.9), 1.0)), contour_field="quadratic",
                                 density_scale=0.25, glow="own"),
    "random_tetrahedra": scene("Random values at the nodes of 384 irregular tetrahedra.", "random", view((17, 16)), field="random"),
    "random_two_fields": scene("Random densities and colours at the nodes of 384 irregular tetrahedra; parallel, glow of its own.",
                               "random", view((16, 16), **PARALLEL), field="random", colour_field="random_other", glow="own"),
    "random_quadratic": scene("Random values at the nodes of 48 tetrahedra of ten nodes.", "random_quadratic", view((15, 15)),
                              field="random"),
    "bent": scene("A linear field in 48 tetrahedra of ten nodes whose edges are bent, on the cube's surface within it.", "bent",
                  view((24, 24))),
    "bent_along_z": scene("The same along an axis: rays through nodes and touching bent faces.", "bent",
                          {"size": (17, 17), "eye": (0.5, 0.5, 3.0), "target": (0.5, 0.5, 0.5), "up": (0.0, 1.0, 0.0),
                           "width_mm": 1.0625}),
    "bent_from_node": scene("The same, the eye at the node in the middle.", "bent", along_z((17, 17), 5.0, (0.5, 0.5, 0.5))),
    "random_bent": scene("Random densities and colours at the nodes of 48 tetrahedra of ten nodes with bent edges.",
                         "random_bent", view((13, 13)), field="random", colour_field="random_other"),
    "random_bent_parallel": scene("The same, parallel, glow of its own.", "random_bent", view((13, 13), **PARALLEL),
                                  field="random_other", colour_field="random", glow="own"),
    "cubic": scene("Random values at the nodes of six tetrahedra of 20 nodes: of degree 3 along a ray; parallel.", "cubic",
                   view((9, 9), eye=(3.0, -1.5, 2.5), target=(0.375, 0.375, 0.375), width_mm=0.875), field="random",
                   glow="own"),
    "bent_hexahedra": scene("Random densities and colours at the nodes of two hexahedra of 20 nodes, all of them moved.",
                            "bent_hexahedra", NEAR, field="random", colour_field="random_other"),
    "bent_wedges": scene("The same of two wedges of 15 nodes.", "bent_wedges", NEAR, field="random",
                         colour_field="random_other"),
    "bent_pyramids": scene("The same of six pyramids of 13 nodes.", "bent_pyramids", view((8, 8), fov_y_deg=19.0), field="random",
                           colour_field="random_other"),
    "tapered_hexahedra": scene("Random values at the nodes of eight tapered hexahedra.", "tapered_hexahedra",
                               view((13, 13), eye=(-1.9, 2.2, 3.1)), field="random"),
    "tapered_wedges": scene("Random densities and colours at the nodes of 16 tapered wedges.", "tapered_wedges",
                            view((13, 13), **PARALLEL), field="random", colour_field="random_other"),
    "tapered_pyramids": scene("Random values at the nodes of six tapered pyramids; glow of its own.", "tapered_pyramids",
                              view((13, 13)), field="random", glow="own"),
    "hole": scene("A cube with a hole.", "with_hole", view((33, 33))),
    "apart": scene("Two cubes apart, one behind the other, of tetrahedra and of wedges.", "apart",
                   view((32, 24), eye=(4.5, 1.9, 2.2), target=(1.2, 0.6, 0.7), fov_y_deg=30.0)),
    "beside": scene("Two cubes, of hexahedra and of tetrahedra, that meet in a part of a side.", "beside",
                    view((32, 24), eye=(3.5, -2.0, 2.6), target=(1.0, 0.75, 0.6), fov_y_deg=34.0)),
}
