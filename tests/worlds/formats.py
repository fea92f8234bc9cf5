"""Samples as files of the programs people record with. Each writer says what a user must add because the file cannot: the rate."""

import struct

import numpy as np


def column(values):
    return [f"{value:.7g}" for value in values]


def csv_points(path, values, unit, fs_hz):
    """Comma and point, a time column in seconds, units in the head."""
    times = np.arange(len(values)) / fs_hz
    rows = (f"{time:.6f},{value}" for time, value in zip(times, column(values)))
    path.write_text(f"Time [s],Laser [{unit}]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return []


def csv_commas(path, values, unit, fs_hz):
    """Semicolon and decimal comma, names and units in two lines, a line of the program's above."""
    times = np.arange(len(values)) / fs_hz
    rows = (f"{time:.6f};{value}".replace(".", ",") for time, value in zip(times, column(values)))
    head = f"Export of Messwerk 4\nZeit;Weg\ns;{unit}\n"
    path.write_text(head + "\n".join(rows) + "\n", encoding="latin-1")
    return []


def csv_bare(path, values, unit, fs_hz):
    """Nothing but numbers, one a line: no rate, no unit."""
    path.write_text("\n".join(column(values)) + "\n", encoding="utf-8")
    return ["--rate", repr(fs_hz)]


def wav(path, values, unit, fs_hz):
    """24 bits at a whole rate, full scale a little over the largest sample."""
    full = 1.2 * float(np.max(np.abs(values))) or 1.0
    numbers = np.round(values / full * (2**23 - 1)).astype("<i4")
    data = numbers.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    rate = int(fs_hz)
    head = b"fmt " + struct.pack("<IHHIIHH", 16, 1, 1, rate, 3 * rate, 3, 24)
    body = b"WAVE" + head + b"data" + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)
    path.write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    return []


def lvm(path, values, unit, fs_hz):
    """LabVIEW's text, one channel, no X column."""
    lines = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Reader_Version\t2",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "Multi_Headings\tNo",
        "X_Columns\tNo",
        "Time_Pref\tAbsolute",
        "Date\t2026/03/01",
        "Time\t06:00:00.0000000000000000000",
        "***End_of_Header***\t",
        "\t",
        "Channels\t1\t",
        f"Samples\t{len(values)}\t",
        "Date\t2026/03/01\t",
        "Time\t06:00:00.0000000000000000000\t",
        f"Y_Unit_Label\t{unit}\t",
        "X_Dimension\tTime\t",
        "X0\t0.0000000000000000E+0\t",
        f"Delta_X\t{1 / fs_hz:.15E}\t",
        "***End_of_Header***\t\t",
        "X_Value\tResponse\tComment",
    ]
    path.write_text("\n".join(lines + [f"\t{value}" for value in column(values)]) + "\n", encoding="utf-8")
    return []


def npy(path, values, unit, fs_hz):
    np.save(path, values.astype("<f4"))
    return ["--rate", repr(fs_hz)]


def mat(path, values, unit, fs_hz):
    """MATLAB's version 5, one vector of doubles, not packed."""

    def element(kind, data):
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    flags = element(6, struct.pack("<II", 6, 0))
    sizes = element(5, struct.pack("<ii", len(values), 1))
    name = element(1, b"laser")
    head = b"MATLAB 5.0 MAT-file".ljust(116) + b"\0" * 8 + struct.pack("<H", 0x0100) + b"IM"
    matrix = flags + sizes + name + element(9, values.astype("<f8").tobytes())
    path.write_bytes(head + element(14, matrix))
    return ["--rate", repr(fs_hz)]


def uff(path, values, unit, fs_hz):
    """Dataset 58 as text, single precision, even spacing."""
    lines = [
        "    -1",
        "    58",
        "laser",
        "NONE",
        "01-Mar-26  06:00:00",
        "NONE",
        "NONE",
        "    1         0    0         0       NONE         1   3       NONE         1   3",
        f"{2:10d}{len(values):10d}{1:10d}{0.0:13.5e}{1 / fs_hz:13.5e}{0.0:13.5e}",
        f"{17:10d}    0    0    0 {'Time':<20} {'s':<20}",
        f"{8:10d}    0    0    0 {'Response':<20} {unit:<20}",
        f"{0:10d}    0    0    0 {'NONE':<20} {'NONE':<20}",
        f"{0:10d}    0    0    0 {'NONE':<20} {'NONE':<20}",
    ]
    for begin in range(0, len(values), 6):
        lines.append("".join(f"{value:13.5e}" for value in values[begin : begin + 6]))
    lines.append("    -1")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return []


# Name, ending, writer; recordings are written by `recording.py`.
WRITERS = [
    ("csv", ".csv", csv_points),
    ("mcap", ".mcap", None),
    ("wav", ".wav", wav),
    ("csv, decimal comma", ".csv", csv_commas),
    ("lvm", ".lvm", lvm),
    ("npy", ".npy", npy),
    ("mat", ".mat", mat),
    ("uff", ".uff", uff),
    ("txt, bare", ".txt", csv_bare),
]
