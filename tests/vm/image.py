# SPDX-License-Identifier: Apache-2.0
"""The virtual machine's image: Debian's own kernel, as an ELF file that QEMU starts without a boot
loader, and a first file system that holds busybox and drivers. Everything else the machine reads
from this computer's root.

The kernel is downloaded by apt-get, unpacked, never installed. Made once per kernel version and kept
in $XDG_CACHE_HOME/haarlight/vm (or ~/.cache/haarlight/vm)."""

import hashlib
import lzma
import os
import pathlib
import re
import shutil
import struct
import subprocess
import tempfile
import zlib

HERE = pathlib.Path(__file__).resolve().parent
BUSYBOX = pathlib.Path("/bin/busybox")
KEPT = 4  # images, 73 MB each

# What the machine can load; what these need comes with them.
DRIVERS = ["virtio_pci", "9pnet_virtio", "9p", "vivid", "xhci_pci", "ftdi_sio", "usbmon",
           "virtio_console"]
# Where they and what they need are in the package.
FOLDERS = ["drivers/media", "drivers/usb", "drivers/virtio", "drivers/char", "drivers/i2c",
           "drivers/video", "net/9p", "fs/9p", "fs/netfs", "fs/fscache", "lib", "crypto"]


class Unavailable(Exception):
    """The image cannot be made here: no package, no network."""


def quietly(*words, **more):
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, **more)
    if done.returncode != 0:
        raise Unavailable(f"{' '.join(map(str, words))}: {(done.stderr or done.stdout).strip()[-400:]}")
    return done.stdout


def kernel_package():
    """The package that linux-image-amd64 stands for today: it moves with security updates."""
    if not shutil.which("apt-cache"):
        raise Unavailable("no apt-cache: this is not Debian")
    for has_asked in (False, True):
        known = subprocess.run(["apt-cache", "depends", "linux-image-amd64"], capture_output=True,
                               text=True)
        found = re.search(r"Depends: (linux-image-\d\S*-amd64)\b", known.stdout)
        if found:
            return found[1]
        if not has_asked:  # fresh containers have no lists
            quietly(*([] if os.geteuid() == 0 else ["sudo", "-n"]), "apt-get", "update")
    raise Unavailable("apt-cache knows no linux-image-amd64: is this Debian on a PC?")


def elf_of(bzimage):
    """The kernel inside a bzImage: its payload, decompressed."""
    data = bzimage.read_bytes()
    if data[0x202:0x206] != b"HdrS":
        raise Unavailable(f"{bzimage}: not a bzImage")
    begin = ((data[0x1F1] or 4) + 1) * 512
    offset, length = struct.unpack_from("<II", data, 0x248)
    payload = data[begin + offset:begin + offset + length]
    if payload[:6] == b"\xfd7zXZ\0":
        elf = lzma.LZMADecompressor().decompress(payload)
    elif payload[:2] == b"\x1f\x8b":
        elf = zlib.decompressobj(31).decompress(payload)
    elif payload[:4] == b"\x28\xb5\x2f\xfd":
        elf = subprocess.run(["zstd", "-dc"], input=payload[:-4], capture_output=True,
                             check=True).stdout
    else:
        raise Unavailable(f"{bzimage}: packed in an unknown way ({payload[:6].hex()})")
    if elf[:4] != b"\x7fELF":
        raise Unavailable(f"{bzimage}: holds no ELF file")
    return elf


class Archive:
    """A cpio archive in the format the kernel unpacks at its start, uncompressed."""

    def __init__(self):
        self.parts = []
        self.count = 0

    def add(self, name, mode, data=b""):
        self.count += 1
        encoded = name.encode() + b"\0"
        fields = [self.count, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(encoded), 0]
        header = b"070701" + b"".join(b"%08X" % f for f in fields)
        self.parts += [header, encoded, b"\0" * (-(len(header) + len(encoded)) % 4),
                       data, b"\0" * (-len(data) % 4)]

    def bytes(self):
        self.add("TRAILER!!!", 0)
        return b"".join(self.parts)


def first_files(tree, version):
    """busybox, the drivers, and /drivers: one line per driver, with what to load before it."""
    archive = Archive()
    for folder in ("bin", "dev", "proc", "sys", "host", "modules"):
        archive.add(folder, 0o040755)
    archive.add("bin/busybox", 0o100755, BUSYBOX.read_bytes())
    archive.add("init", 0o100755, (HERE / "guest/init").read_bytes())
    lines, packed = [], set()
    for driver in DRIVERS:
        steps = quietly("/usr/sbin/modprobe", "-d", tree, "-S", version, "--show-depends", driver)
        files = [pathlib.Path(line.split()[1]) for line in steps.splitlines()
                 if line.startswith("insmod")]
        lines.append(" ".join([driver] + [f.name for f in files]))
        for file in files:
            if file.name not in packed:
                packed.add(file.name)
                archive.add(f"modules/{file.name}", 0o100644, file.read_bytes())
    archive.add("drivers", 0o100644, ("\n".join(lines) + "\n").encode())
    return archive.bytes()


def build(package, target):
    """@throws Unavailable"""
    target.parent.mkdir(parents=True, exist_ok=True)
    work = pathlib.Path(tempfile.mkdtemp(prefix="making.", dir=target.parent))
    try:
        version = package.removeprefix("linux-image-")
        quietly("apt-get", "download", "-q", package, cwd=work)
        deb, tree = next(work.glob("*.deb")), work / "tree"
        tree.mkdir()
        wanted = ["./boot/vmlinuz*", "./lib/modules/*/modules.*",
                  *(f"./lib/modules/*/kernel/{folder}/*" for folder in FOLDERS)]
        unpack = subprocess.Popen(["dpkg", "--fsys-tarfile", deb], stdout=subprocess.PIPE)
        quietly("tar", "-x", "-C", tree, "--wildcards", *wanted, stdin=unpack.stdout)
        if unpack.wait() != 0:
            raise Unavailable(f"{deb.name} cannot be unpacked")
        quietly("/usr/sbin/depmod", "-b", tree, version)
        made = work / "image"
        made.mkdir()
        (made / "vmlinux").write_bytes(elf_of(tree / f"boot/vmlinuz-{version}"))
        (made / "initrd").write_bytes(first_files(tree, version))
        if not target.exists():  # else somebody was quicker
            os.replace(made, target)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    images = sorted((f for f in target.parent.iterdir() if (f / "initrd").exists()),
                    key=lambda f: f.stat().st_mtime, reverse=True)
    for old in images[KEPT:]:
        shutil.rmtree(old, ignore_errors=True)


def image():
    """The folder of vmlinux and initrd; makes it when it is not there. @throws Unavailable"""
    for program in ("/usr/sbin/modprobe", BUSYBOX, "/usr/bin/qemu-system-x86_64"):
        if not pathlib.Path(program).exists():
            raise Unavailable(f"{program} is missing: scripts/install_packages check")
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
    # What goes in is part of the name, so that a change makes a new image.
    content = hashlib.sha256()
    for file in (HERE / "image.py", HERE / "guest/init"):
        content.update(file.read_bytes())
    images, suffix = cache / "haarlight/vm", content.hexdigest()[:10]
    try:
        package = kernel_package()
        target = images / f"{package.removeprefix('linux-image-')}-{suffix}"
        if not (target / "initrd").exists():
            build(package, target)
        return target
    except Unavailable:
        made = sorted(images.glob(f"*-{suffix}/initrd"), key=lambda f: f.stat().st_mtime)
        if not made:
            raise
        return made[-1].parent  # no network today: an image of another day
