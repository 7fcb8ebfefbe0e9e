#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A scene of many small lamps over a floor with boxes, for surface_errors.py: many_lights.py N SCENE.toml

Lamps of 4 mm, powers 1 to 100, spread evenly in 4 m x 4 m x 0.45 m.
"""

import pathlib
import random
import sys

random.seed(1)
lines = ['schema = 1', 'name = "many lamps"', '[[material]]', 'name = "floor"', 'kd = [0.7]']
for power in range(1, 101):
    lines += ['[[material]]', f'name = "lamp{power}"', 'kd = [0, 0, 0]', f'emits = [{10 * power}, {10 * power}, {10 * power}]']
lines += ['[[quad]]', 'corners = [[-2000, -2000, 0], [2000, -2000, 0], [2000, 2000, 0], [-2000, 2000, 0]]', 'material = "floor"']
for _ in range(40):
    x, y, height = random.uniform(-1500, 1500), random.uniform(-1500, 1500), random.uniform(50, 400)
    lines += ['[[box]]', f'low = [{x:.1f}, {y:.1f}, 0]', f'high = [{x + 150:.1f}, {y + 150:.1f}, {height:.1f}]', 'material = "floor"']
for _ in range(int(sys.argv[1])):
    x, y, z = random.uniform(-2000, 2000), random.uniform(-2000, 2000), random.uniform(450, 900)
    corners = [(x, y), (x, y + 4), (x + 4, y + 4), (x + 4, y)]  # clockwise from above: they shine down
    lines += ['[[quad]]', f'corners = [{", ".join(f"[{a:.2f}, {b:.2f}, {z:.2f}]" for a, b in corners)}]',
              f'material = "lamp{random.randint(1, 100)}"']
lines += ['[camera]', 'size = [128, 128]', 'eye = [0, -3000, 2200]', 'target = [0, 0, 0]', 'fov_y_deg = 45']
pathlib.Path(sys.argv[2]).write_text("\n".join(lines) + "\n")
