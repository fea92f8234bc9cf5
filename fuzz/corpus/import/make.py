"""Writes the files of this folder: measurements by pyuff, scipy, numpy and npTDMS, and what those read back, as bits.

    pip install pyuff==2.5.8 scipy==1.17.1 npTDMS==1.13.0 lvm_read==1.26 && python make.py

TDMS files that npTDMS does not write (big endian, interleaved, unfinished) and LVM files are put together here, and read by npTDMS
and lvm_read.
"""

import json
import pathlib
import struct

import lvm_read
import nptdms
import numpy
import pyuff
import scipy.io
import scipy.io.wavfile

COUNT = 32
time = numpy.arange(COUNT) / 200.0
motion = numpy.sin(28.2 * time) + 0.1 * numpy.cos(611.0 * time)
motion[5] = -0.0
expected = {}


def bits(values):
    return ["%016x" % struct.unpack(">Q", struct.pack(">d", float(value)))[0] for value in values]


def dataset(name, values, function=1, binary=0, spacing=1):
    return {
        "type": 58, "binary": binary, "func_type": function, "id1": name, "id3": "16-Aug-26  14:03:12", "rsp_node": 1, "rsp_dir": 3,
        "ref_node": 1, "ref_dir": 3, "data": values, "x": numpy.arange(len(values)) / 1024.0, "abscissa_spacing": spacing,
        "abscissa_spec_data_type": 17, "abscissa_axis_lab": "Time", "abscissa_axis_units_lab": "s",
        "ordinate_spec_data_type": 8, "ordinate_axis_lab": "Displacement", "ordinate_axis_units_lab": "mm",
        "orddenom_spec_data_type": 0,
    }


def uff(name, datasets):
    pathlib.Path(name).unlink(missing_ok=True)
    # One by one: "overwrite" with binary sets loses the first.
    for one in datasets:
        pyuff.UFF(name).write_sets(one, "add")
    expected[name] = {
        one["id1"].strip(): bits(one["data"])
        for one in pyuff.UFF(name).read_sets() if one["type"] == 58 and one["func_type"] == 1
    }


uff("text.uff", [dataset("laser 1", motion), dataset("frf", motion, function=4), dataset("laser 2", 1e-3 * motion, spacing=0)])
uff("binary.uff", [dataset("laser 1", motion, binary=1), dataset("auto", motion, function=2, binary=1),
                   dataset("laser 2", 1e-3 * motion, binary=1)])

for name, compressed in [("plain.mat", False), ("packed.mat", True)]:
    scipy.io.savemat(name, {
        "t": time, "laser": motion, "pair": numpy.array([motion, 2 * motion]), "counts": numpy.arange(COUNT, dtype=numpy.int16),
        "single": motion.astype(numpy.float32), "fs": 200.0, "name": "nave", "z": motion + 1j, "s": {"a": 1.0},
    }, do_compression=compressed)
    read = scipy.io.loadmat(name)
    expected[name] = {
        "laser": bits(read["laser"].ravel()), "pair(1,:)": bits(read["pair"][0]), "pair(2,:)": bits(read["pair"][1]),
        "counts": bits(read["counts"].ravel()), "single": bits(read["single"].ravel()),
    }

scale = numpy.round(20000 * motion)
for name, values, most in [("whole.wav", scale.astype(numpy.int16), 2.0**15), ("float.wav", motion.astype(numpy.float32), 1.0),
                           ("double.wav", motion, 1.0), ("long.wav", (65536 * scale).astype(numpy.int32), 2.0**31)]:
    scipy.io.wavfile.write(name, 2000, values)
    _, read = scipy.io.wavfile.read(name)
    expected[name] = {"channel-1": bits(read.astype(float) / most)}


for name, values, version in [
    ("row.npy", motion, None), ("swapped.npy", scale.astype(">i2"), None), ("half.npy", motion.astype("<f2"), (2, 0)),
    ("table.npy", numpy.column_stack([motion, 2 * motion]).astype("<f4"), (3, 0)),
    ("columns.npy", numpy.asfortranarray(numpy.column_stack([motion, 2 * motion, -motion])), None),
    ("cube.npy", numpy.stack([numpy.column_stack([k * motion, -k * motion]) for k in (1.0, 2.0, 3.0)]), None),
]:
    with open(name, "wb") as out:
        numpy.lib.format.write_array(out, values, version=version)
    read = numpy.load(name).astype(float)
    expected[name] = (
        {"samples": bits(read)} if read.ndim == 1 else
        {"[:,%d]" % k: bits(read[:, k]) for k in range(read.shape[1])} if read.ndim == 2 else
        {"[%d,:,%d]" % (i, k): bits(read[i, :, k]) for i in range(read.shape[0]) for k in range(read.shape[2])})

when = numpy.datetime64("2026-08-16T14:03:12.250000")
wave = {"wf_increment": 1 / 1024, "wf_start_time": when, "wf_start_offset": 0.0, "unit_string": "mm"}
with nptdms.TdmsWriter("plain.tdms") as out:
    for part in range(3):
        some = slice(10 * part, 10 * part + 10)
        out.write_segment([
            nptdms.RootObject({"title": "nave"}), nptdms.GroupObject("run", {"operator": "nobody"}),
            nptdms.ChannelObject("run", "laser's", motion[some], wave),
            nptdms.ChannelObject("run", "single", motion[some].astype(numpy.float32), {**wave, "unit_string": "m/s"}),
            nptdms.ChannelObject("run", "counts", scale[some].astype(numpy.int16), wave),
            nptdms.ChannelObject("run", "notes", ["ok", "odd"], {}),
        ])


def text(order, words):
    words = words.encode()
    return struct.pack(order + "L", len(words)) + words


def segment(order, toc, objects, raw, unfinished=False):
    """Objects: path, index (None: no data, 0: as before, else type and count), properties (name, type, bytes)."""
    meta = b""
    if objects is not None:
        meta = struct.pack(order + "L", len(objects))
        for path, index, properties in objects:
            meta += text(order, path)
            meta += (struct.pack(order + "L", 0xFFFFFFFF) if index is None else struct.pack(order + "L", 0) if index == 0 else
                     struct.pack(order + "LLLQ", 20, index[0], 1, index[1]))
            meta += struct.pack(order + "L", len(properties))
            for key, kind, value in properties:
                meta += text(order, key) + struct.pack(order + "L", kind) + value
    toc |= (0x2 if objects is not None else 0) | (0x8 if raw else 0) | (0x40 if order == ">" else 0)
    size = 0xFFFFFFFFFFFFFFFF if unfinished else len(meta) + len(raw)
    return b"TDSm" + struct.pack("<L", toc) + struct.pack(order + "LQQ", 4713, size, len(meta)) + meta + raw


def tdms(name):
    with nptdms.TdmsFile.open(name) as file:
        expected[name] = {
            channel.name: bits(channel[:]) for group in file.groups() for channel in group.channels()
            if channel.dtype.kind in "fiu"}


tdms("plain.tdms")

INTERLEAVED, NEW = 0x20, 0x4
laser, counts = "/'run'/'laser'", "/'run'/'counts'"


def step(order):
    return [("wf_increment", 10, struct.pack(order + "d", 1 / 512)), ("unit_string", 0x20, text(order, "um"))]


def rows(order, begin, end):
    return b"".join(struct.pack(order + "dh", motion[k], int(scale[k])) for k in range(begin, end))


swapped = motion.astype(">f8").tobytes()
data = segment(">", INTERLEAVED | NEW, [("/'run'", None, []), (laser, (10, 4), step(">")), (counts, (2, 4), [])], rows(">", 0, 8))
# As before, nothing said; as before, said by 0; one channel silent; the list made anew in the other byte order.
data += segment(">", INTERLEAVED, None, rows(">", 8, 12))
data += segment(">", 0, [(laser, 0, []), (counts, None, [])], swapped[12 * 8:20 * 8])
data += segment("<", NEW, [(counts, (2, 3), []), (laser, (10, 2), [])], scale[12:15].astype("<i2").tobytes() + motion[20:22].tobytes())
pathlib.Path("odd.tdms").write_bytes(data)
tdms("odd.tdms")
for name, tail in [("unfinished.tdms", rows("<", 8, 12) + rows("<", 12, 13)[:-1])]:
    whole = segment("<", INTERLEAVED | NEW, [(laser, (10, 4), step("<")), (counts, (2, 4), [])], rows("<", 0, 8))
    pathlib.Path(name).write_bytes(whole + segment("<", INTERLEAVED, None, tail, unfinished=True))
    tdms(name)

HEAD = ("LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t{dot}\nMulti_Headings\tYes\n"
        "X_Columns\t{x}\nTime_Pref\tAbsolute\nOperator\tnobody\nDate\t2026/08/16\nTime\t14:03:12{dot}2500000000000000000\n"
        "***End_of_Header***\t\n\t\n")
PART = ("Channels\t2\t\t{x}\nSamples\t{n}\t{x}{n}\t{x}\nDate\t2026/08/16\t{x}2026/08/16\t{x}\n"
        "Time\t{at}2500000000000000000\t{x}{at}2500000000000000000\t{x}\nY_Unit_Label\tmm\t{x}m/s^2\t{x}\n"
        "X_Dimension\tTime\t{x}Time\t{x}\nX0\t0{dot}0000000000000000E+0\t{x}0{dot}0000000000000000E+0\t{x}\n"
        "Delta_X\t{step}\t{x}{step}\t{x}\n***End_of_Header***\t\t\t{x}\nX_Value\tlaser\t{named}response\tComment\n")


def lvm(name, dot, x, parts):
    with open(name, "w", newline="") as out:
        out.write(HEAD.format(dot=dot, x=x).replace("\n", "\r\n"))
        for begin, end, at in parts:
            tab = "\t" if x == "Multi" else ""
            part = PART.format(dot=dot, x=tab, n=end - begin, at=at + dot, step=("%.6E" % (1 / 1024)).replace(".", dot),
                               named="X_Value\t" if x == "Multi" else "")
            for k in range(begin, end):
                stamp = "" if x == "No" else "%.6f" % ((k - begin) / 1024)
                again = stamp + "\t" if x == "Multi" else ""
                part += ("%s\t%.6f\t%s%.9E" % (stamp, motion[k], again, -2 * motion[k])).replace(".", dot) + "\n"
            out.write((part + "\n").replace("\n", "\r\n"))
    read = lvm_read.read(name, read_from_pickle=False, dump_file=False)
    first, second = (0, 1) if x == "No" else (1, 3) if x == "Multi" else (1, 2)
    data = [read[k]["data"] for k in range(read["Segments"])]
    expected[name] = {"laser": bits(numpy.concatenate([part[:, first] for part in data])),
                      "response": bits(numpy.concatenate([part[:, second] for part in data]))}


lvm("commas.lvm", ",", "No", [(0, COUNT, "14:03:12")])
lvm("segments.lvm", ".", "One", [(0, 16, "14:03:12"), (16, COUNT, "14:05:00")])
lvm("multi.lvm", ".", "Multi", [(0, COUNT, "14:03:12")])

with open("expected.json", "w") as out:
    json.dump(expected, out, indent=1)
    out.write("\n")
