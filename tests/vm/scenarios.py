"""The scenarios: what is in the machine, what is run in it, and what must be true of what comes out.

Each prepares a job folder (build/vm/NAME), boots, runs guest/NAME.py and judges the results here."""

import dataclasses
import json
import pathlib
import re
import subprocess
import sys

from machine import Machine
from truth import Session

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
OUT = ROOT / "build/vm"
SCENE = ROOT / "configs/scenes/blocks.toml"
SMALL_RIG = ROOT / "configs/rigs/small8.toml"
INSIDE = "/dev/shm/work"  # as guest/lab.py


@dataclasses.dataclass
class Result:
    passed: bool
    text: str
    notes: list


def changed(text, **changes):
    """A rig file's text with other values of some keys; each key has one line."""
    for key, value in changes.items():
        text, n = re.subn(rf"(?m)^{key} = .*", f"{key} = {value}", text)
        if n != 1:
            raise ValueError(f"the rig file has {n} lines '{key} = ...'")
    return text



def rig_text(camera, controller_kind, address, **changes):
    """small8 for the machine. `camera`: changes of its block's keys."""
    text = SMALL_RIG.read_text()
    head, block = text.split("[controller]", 1)
    head = changed(head, **camera)
    block, n = re.subn(r'(?m)^kind = .*\naddress = .*', f'kind = "{controller_kind}"\naddress = "{address}"',
                       block, count=1)
    assert n == 1
    # [http] has an address of its own, which stays.
    return changed(head + "[controller]" + block, folder=f'"{INSIDE}/sessions"', **changes)


class Scenario:
    drivers = ()
    tied_time = False
    memory_mb = 640
    limit_s = 400

    def devices(self, folder):
        return []

    def files(self):
        """Files of the job folder: name -> text. twin.toml: the simulator's rig, rig.toml: the
        daemon's."""
        raise NotImplementedError

    def job(self):
        """More for job.json, which the scenario inside reads."""
        return {}

    def judge(self, folder, result):
        """Problems found, and figures for people: ([text], text)."""
        raise NotImplementedError


def looped_port(name, driver_words, folder):
    """A port of the machine whose other end is a socket that QEMU's own words connect to."""
    socket = folder / f"{name}.sock"
    return ["-chardev", f"socket,id={name}-inner,path={socket},server=on,wait=off", *driver_words,
            "-chardev", f"socket,id={name}-outer,path={socket}"]


def hands(folder):
    return ["-device", "virtio-serial-pci",
            *looped_port("hands", ["-device", "virtserialport,chardev=hands-inner,name=hands"], folder),
            "-mon", "chardev=hands-outer,mode=readline"]


class Serial(Scenario):
    """Modbus RTU over ftdi_sio and 8250, a whole 8 x 8 capture; the adapter is pulled out and put in"""

    drivers = ["virtio_console", "xhci_pci", "ftdi_sio"]
    adapter = "/dev/serial/by-id/usb-QEMU_QEMU_USB_SERIAL_haarlight-ftdi-if00-port0"
    plug = "usb-serial,chardev=line-outer,id=adapter,serial=haarlight-ftdi"

    def devices(self, folder):
        return [*hands(folder), "-device", "qemu-xhci",
                *looped_port("line", ["-device", "isa-serial,chardev=line-inner"], folder),
                "-device", self.plug]

    def files(self):
        camera = {"device": f'"{INSIDE}/camera.sock"', "fps": "40.0"}
        return {"twin.toml": rig_text(camera, "modbus_rtu", f"{INSIDE}/controller:115200"),
                "rig.toml": rig_text(camera, "modbus_rtu", f"{self.adapter}:115200"),
                "plan.toml": (ROOT / "configs/plans/quick.toml").read_text()}

    def job(self):
        return {"adapter": self.adapter, "replug": f"device_add {self.plug}", "unplug_after": 16}

    def judge(self, folder, result):
        session = Session(folder)
        problems = session.problems(n_shots=64)
        if result["suspended_s"] > 1.0:
            problems.append(f"suspended {result['suspended_s']:.2f} s after the adapter was out: more than 1 s")
        if result["committed_at_rest"] >= 64:
            problems.append("the capture was over before the adapter was pulled out")
        return problems, (f"{len(session.frames)} shots by RTU; adapter out: suspended after "
                          f"{result['suspended_s'] * 1e3:.0f} ms; in again: on after "
                          f"{result['resumed_s']:.1f} s")


ALL = {"serial": Serial()}


def prepare(name, kernel, bin_folder, script=None):
    """The scenario's machine, its job folder filled."""
    scenario = ALL[name]
    folder = OUT / name
    machine = Machine(folder, kernel, script or f"exec python3 {HERE}/guest/{name}.py\n",
                      scenario.drivers, scenario.devices(folder), scenario.tied_time,
                      scenario.memory_mb)
    for file, text in scenario.files().items():
        (folder / file).write_text(text)
    # Rendering is for the host: a small transport matrix takes a second here, a minute there.
    cache = OUT / "cache"
    subprocess.run([bin_folder / "haarlight-sim/haarlight-sim", folder / "twin.toml", "--scene", SCENE,
                    "--cache", cache, "--only-transport", "--quiet"], check=True)
    job = {"bin": str(bin_folder), "scene": str(SCENE), "cache": str(cache),
           "port": int(re.search(r"(?m)^port = (\d+)", (folder / "rig.toml").read_text())[1])}
    (folder / "job.json").write_text(json.dumps({**job, **scenario.job()}))
    return machine


def run(name, kernel, bin_folder):
    """@return Result"""
    scenario = ALL[name]
    machine = prepare(name, kernel, bin_folder)
    status = machine.run(scenario.limit_s)
    folder = machine.folder
    notes = [f"logs: {folder.relative_to(ROOT)}"]
    if not (folder / "result.json").exists():
        tail = (machine.text("qemu.log") + machine.text("console.log") + machine.text("job.log"))
        return Result(False, f"the machine gave no result (status {status})",
                      notes + tail.splitlines()[-15:])
    result = json.loads((folder / "result.json").read_text())
    problems = list(result["failed"])
    text = ""
    if not problems:
        problems, text = scenario.judge(folder, result)
    if problems:
        return Result(False, problems[0], problems[1:20] + notes +
                      machine.text("job.log").splitlines()[-8:])
    return Result(True, text, [])


def shell(name, kernel, bin_folder):
    """A shell on the machine's second line, this terminal."""
    machine = prepare(name, kernel, bin_folder, "exec setsid -c /bin/bash -i </dev/ttyS1 2>&1\n")
    words = [w if not str(w).startswith("file:") or "job.log" not in str(w) else "mon:stdio"
             for w in machine.words]
    return subprocess.call(list(map(str, words)), stdin=sys.stdin)
