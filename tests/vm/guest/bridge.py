# SPDX-License-Identifier: Apache-2.0
"""A cable between two terminals: bytes from either go to the other. bridge.py A B"""

import os
import select
import sys
import termios
import tty


def open_raw(path):
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd, termios.TCSANOW)
    attributes = termios.tcgetattr(fd)
    attributes[4] = attributes[5] = termios.B115200
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    return fd


def main():
    ends = [open_raw(path) for path in sys.argv[1:3]]
    other = {ends[0]: ends[1], ends[1]: ends[0]}
    while True:
        for fd in select.select(ends, [], [])[0]:
            data = os.read(fd, 4096)
            if not data:
                return
            while data:
                data = data[os.write(other[fd], data):]


main()
