# SPDX-License-Identifier: Apache-2.0
"""The scenarios: what is in the machine, what is run in it, and what must be true of what comes out.

Each prepares a job folder (build/vm/NAME), boots, runs guest/NAME.py and checks the results here."""

import dataclasses
import json
import pathlib
import re
import subprocess
import sys
import threading

from machine import Machine
from truth import Record, Session

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
OUT = ROOT / "build/vm"
SCENE = ROOT / "configs/scenes/blocks.toml"
QUICK_PLAN = ROOT / "configs/plans/quick.toml"
SMALL_RIG = ROOT / "configs/rigs/small8.toml"
INSIDE = "/dev/shm/work"  # as guest/lab.py
RENDERING = threading.Lock()


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
    limit_s = 900  # it hangs, then

    def devices(self, folder):
        return []

    def files(self):
        """Files of the job folder: name -> text. twin.toml: the simulator's rig, rig.toml: the
        daemon's."""
        raise NotImplementedError

    def job(self):
        """More for job.json, which the scenario inside reads."""
        return {}

    def check(self, folder, result):
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


class Capture(Scenario):
    """V4L2 through vivid: 640 frames, each compared with what the simulated camera wrote"""

    drivers = ["vivid node_types=0x101 num_inputs=1 input_types=3 num_outputs=1 output_types=1 "
               "ccs_cap_mode=1 ccs_out_mode=2"]
    tied_time = True
    n_repeats = 10
    # vivid's timestamp is taken when it copies a frame. The frame was written before that, and waited in vivid's
    # queue for two frames of 16.7 ms, longer when its threads slip. So the exposure ended between 0
    # and 75 ms before the timestamp: said to the daemon as a camera that is read out for 75 ms and
    # skewed by as much.
    chain = {"shutter": '"rolling"', "read_us": "75000.0", "skew_us": "75000.0"}

    def camera(self, **more):
        return {"device": '"/dev/video0"', "kind": '"v4l2"', "fps": "59.94", **more}

    def files(self):
        def rig(**more):
            text = rig_text(self.camera(**more), "modbus_tcp", "127.0.0.1:1503")
            return text.replace(
                'format = "Y16 "', 'format = "Y16 "\nexposure_control = "none"\n'
                # The last one: of 64 bits, beyond 32.
                'controls = { loop_video = true, osd_text_mode = 2, integer_64_bits = -20000000003, '
                'timestamp_source = "Start of Exposure" }')
        plan = QUICK_PLAN.read_text()
        twin = rig_text({"device": '"unused"', "fps": "100.0"}, "modbus_tcp", "127.0.0.1:1503")
        return {"twin.toml": twin, "rig.toml": rig(**self.chain),
                "careless.toml": rig(read_us="1000.0"),
                "plan.toml": f"{plan}repeats = {self.n_repeats}\n", "short_plan.toml": plan}

    def check(self, folder, result):
        good, rough = Session(folder / "good"), Session(folder / "rough")
        record = Record(folder / "record", 2 * good.form["width"] * good.form["stored_height"])
        problems = good.problems(n_shots=64 * self.n_repeats)
        more, latencies = record.problems(good)
        problems += more
        more, _ = record.problems(rough)
        problems += [f"rough: {p}" for p in rough.problems(n_shots=64) + more]
        # The truth must be able to fail, by times and by tags. A rig file that trusts the timestamp gives
        # every frame an exposure that is too late by what vivid's queue took; whether the pairing is
        # wrong as well depends on where in a frame the light changed. Evidence handed on to the next
        # shot is wrong everywhere.
        careless = Session(folder / "careless")
        n_late = sum("was exposed" in problem for problem in record.problems(careless)[0])
        if n_late != len(careless.frames):
            problems.append(f"a rig file that trusts vivid's timestamp: {n_late} of {len(careless.frames)} "
                            "frames refused for their time: this test proves nothing")
        shifted = good.with_evidence_shifted()
        for what, found in (("tags", shifted.problems(64 * self.n_repeats)),
                            ("record", record.problems(shifted)[0])):
            n_wrong = sum("WRONG PAIRING" in problem for problem in found)
            if n_wrong != len(shifted.frames):
                problems.append(f"evidence of the next shot: {n_wrong} of {len(shifted.frames)} frames "
                                f"refused by the {what}: this test proves nothing")
        rough_faults = result["rough"]["counters"]["camera_faults_total"]
        if rough_faults < 1:
            problems.append("rough: vivid was asked to break, and the daemon noticed nothing")
        counters = result["good"]["counters"]
        return problems, problems or (
            f"{len(good.frames)} frames, each byte for byte one of {record.n} written, 0 wrong pairings "
            f"(when the timestamp is trusted: {len(careless.wrong_pairings())} of 64, and {n_late} wrong "
            "times); exposed "
            f"{min(latencies) / 1e6:.0f} to {max(latencies) / 1e6:.0f} ms before the timestamp; "
            f"{counters['duplicates_total']:.0f} repeats refused of {counters['frames_total']:.0f} frames; "
            f"64 shots while vivid broke its stream, {rough_faults:.0f} faults")


def check_replug(folder, result, n_shots, what):
    session = Session(folder / "sessions")
    problems = session.problems(n_shots)
    if result["suspended_s"] > 1.0:
        problems.append(f"suspended {result['suspended_s']:.2f} s after it was pulled out: more than 1 s")
    if result["committed_at_rest"] >= n_shots:
        problems.append("the capture was over before it was pulled out")
    return problems, (f"{len(session.frames)} shots {what} out: suspended after "
                      f"{result['suspended_s'] * 1e3:.0f} ms; in: goes on after {result['resumed_s']:.1f} s")


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
                "plan.toml": QUICK_PLAN.read_text()}

    def job(self):
        return {"adapter": self.adapter, "replug": f"device_add {self.plug}", "unplug_after": 16}

    def check(self, folder, result):
        return check_replug(folder, result, 64, "by RTU; the adapter")


class Usb(Scenario):
    """The USB light array over xhci, usbfs and libusb, two 8 x 8 captures; pulled out and put in"""

    drivers = ["virtio_console", "xhci_pci"]
    serial = "HL-VM-0001"

    def devices(self, folder):
        return ["-device", "virtio-serial-pci",
                *looped_port("light", ["-device", "virtserialport,chardev=light-inner,name=light"], folder),
                "-device", "qemu-xhci", "-device", "usb-redir,chardev=light-outer"]

    def files(self):
        camera = {"device": f'"{INSIDE}/camera.sock"', "fps": "40.0"}
        rig = rig_text(camera, "usb", self.serial)
        return {"twin.toml": rig, "rig.toml": rig, "plan.toml": QUICK_PLAN.read_text() + "repeats = 2\n"}

    def job(self):
        return {"serial": self.serial, "unplug_after": 16}

    def check(self, folder, result):
        return check_replug(folder, result, 128, "by USB; the device")


ALL = {"capture": Capture(), "serial": Serial(), "usb": Usb()}


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
    with RENDERING:
        subprocess.run([bin_folder / "haarlight-sim/haarlight-sim", folder / "twin.toml", "--scene", SCENE,
                        "--cache", cache, "--only-transport", "--quiet"], check=True)
    job = {"bin": str(bin_folder), "scene": str(SCENE), "cache": str(cache),
           "port": int(re.search(r"(?m)^port = (\d+)", (folder / "rig.toml").read_text())[1])}
    (folder / "job.json").write_text(json.dumps({**job, **scenario.job()}))
    return machine


def unverified(folder, bin_folder):
    """What `haarlight verify` says against the sessions that came out."""
    problems = []
    for info in sorted(folder.glob("*/*/session.json")):
        done = subprocess.run([bin_folder / "haarlight/haarlight", "verify", info.parent],
                              capture_output=True, text=True)
        if done.returncode != 0:
            problems += [f"haarlight verify: {line}" for line in
                         (done.stdout + done.stderr).strip().splitlines()[-3:]]
    return problems


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
        problems, text = scenario.check(folder, result)
    problems += unverified(folder, bin_folder)
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
