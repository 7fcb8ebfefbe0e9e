# SPDX-License-Identifier: Apache-2.0
"""A virtual machine with real drivers: boots, runs one job, ends. QEMU without hardware support, so
that it works wherever QEMU does."""

import pathlib
import shutil
import subprocess
import time


class Machine:
    """@param folder  of this job: everything said in the machine ends up in it
    @param image      of image.image()
    @param devices    more words for QEMU's command line
    @param tied_time  the machine's clock counts its instructions instead of this computer's time: it
                      sees no pause when this computer is busy, and none is waited out when it is
                      idle itself. Not for a machine that talks to programs outside."""

    def __init__(self, folder, image, script, drivers=(), devices=(), tied_time=False, memory_mb=640):
        self.folder = pathlib.Path(folder)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        (self.folder / "run").write_text(script)
        (self.folder / "drivers").write_text("".join(line + "\n" for line in drivers))
        self.words = [
            "qemu-system-x86_64", "-accel", "tcg,thread=single" if tied_time else "tcg",
            *(["-icount", "shift=1,sleep=off"] if tied_time else []),
            "-m", memory_mb, "-smp", 1, "-M", "pc,vmport=off", "-nographic", "-nodefaults",
            "-no-user-config", "-no-reboot", "-kernel", image / "vmlinux", "-initrd", image / "initrd",
            "-append", "console=ttyS0 quiet panic=-1 oops=panic nokaslr mitigations=off preempt=none",
            "-serial", f"file:{self.folder}/console.log", "-serial", f"file:{self.folder}/job.log",
            "-fsdev", "local,id=root,path=/,security_model=none,readonly=on,multidevs=remap",
            "-device", "virtio-9p-pci,fsdev=root,mount_tag=root",
            "-fsdev", f"local,id=job,path={self.folder},security_model=none",
            "-device", "virtio-9p-pci,fsdev=job,mount_tag=job", *devices]
        self.process = None

    def run(self, limit_s):
        """@return the job's exit status; None when the machine gave none (crash, too slow)"""
        begin = time.monotonic()
        with open(self.folder / "qemu.log", "wb") as log:
            self.process = subprocess.Popen(list(map(str, self.words)), stdin=subprocess.DEVNULL,
                                            stdout=log, stderr=log)
            try:
                self.process.wait(timeout=limit_s)
            except subprocess.TimeoutExpired:
                pass
            finally:
                self.end()
        self.seconds = time.monotonic() - begin
        status = self.folder / "status"
        return int(status.read_text()) if status.exists() else None

    def end(self):
        if self.process and self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def text(self, name):
        path = self.folder / name
        return path.read_text(errors="replace").replace("\r", "") if path.exists() else ""
