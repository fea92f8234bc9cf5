"""A file system that forgets what was not flushed: python3 power.py BACKING MOUNT

Files of BACKING show under MOUNT. What is written stays in memory until the file is flushed (fsync, fdatasync, O_SYNC), and goes to
BACKING then. Names (create, rename, remove) last at once, as on a file system with a journal of its metadata.

After SIGUSR1 the power is lost at one of the next writes or flushes, so that it comes between a write and its flush as well: all that was not
flushed is gone, the number of bytes is printed, and nothing is answered. SIGUSR2 says that the programs are being killed: their operations
fail. After another one the disk is in use again.

Needs root or fusermount, and Debian's python3-fusepy.
"""

import errno
import os
import random
import signal
import sys
import time

import fusepy as fuse

# Writes and flushes from the signal to the loss, at most, and the time after which it comes without any [s].
SOON = 40
LATEST_S = 2.0
WRITING = ("write", "fsync", "create", "rename")


class Pending:
    """What was written to a file since it was flushed: its size, and pieces in order."""

    def __init__(self, size):
        self.size = size
        self.pieces = []

    def cut(self, size):
        self.size = size
        cut = [(at, data[: max(0, size - at)]) for at, data in self.pieces]
        self.pieces = [(at, data) for at, data in cut if data]


class Volatile(fuse.Operations):
    use_ns = True

    def __init__(self, backing):
        self.backing = backing
        self.pending = {}
        # Least size that a file had since it was flushed: beyond it BACKING holds what was cut off.
        self.kept = {}
        self.synced = set()
        # Writes and flushes until the power is lost, or the time of it, and signals until it is back.
        self.left = None
        self.until = 0.0
        self.away = 0
        self.random = random.Random(1)

    def __call__(self, operation, *args):
        if self.left is not None:
            self.left -= operation in WRITING
            if self.left < 0 or time.monotonic() > self.until:
                self.left = None
                self.lose()
        while self.away == 2:
            time.sleep(0.002)
        if self.away:
            raise fuse.FuseOSError(errno.EIO)
        return super().__call__(operation, *args)

    def soon(self, *_):
        self.left = self.random.randrange(SOON)
        self.until = time.monotonic() + LATEST_S

    def back(self, *_):
        self.away = max(0, self.away - 1)

    def below(self, path):
        return os.path.join(self.backing, path.lstrip("/"))

    def of(self, file):
        stat = os.fstat(file)
        if stat.st_ino not in self.pending:
            self.pending[stat.st_ino] = Pending(stat.st_size)
            self.kept[stat.st_ino] = stat.st_size
        return stat.st_ino, self.pending[stat.st_ino]

    def flush_file(self, file):
        number = os.fstat(file).st_ino
        pending = self.pending.pop(number, None)
        if pending:
            os.ftruncate(file, self.kept.pop(number))
            os.ftruncate(file, pending.size)
            for at, data in pending.pieces:
                os.pwrite(file, data, at)
            os.fsync(file)

    def lose(self):
        self.away = 2
        lost = sum(len(data) for one in self.pending.values() for _, data in one.pieces)
        print(f"lost {lost} bytes of {len(self.pending)} files", flush=True)
        self.pending.clear()
        self.kept.clear()

    # Files.

    def open(self, path, info):
        is_read = info.flags & os.O_ACCMODE == os.O_RDONLY
        info.fh = os.open(self.below(path), os.O_RDONLY if is_read else os.O_RDWR)
        if info.flags & os.O_DSYNC:
            self.synced.add(info.fh)
        if info.flags & os.O_TRUNC:
            self.cut(info.fh, 0)
        return 0

    def create(self, path, mode, info):
        info.fh = os.open(self.below(path), os.O_RDWR | os.O_CREAT, mode)
        if info.flags & os.O_DSYNC:
            self.synced.add(info.fh)
        return 0

    def read(self, path, size, at, info):
        file = info.fh
        stat = os.fstat(file)
        pending = self.pending.get(stat.st_ino)
        if not pending:
            return os.pread(file, size, at)
        size = max(0, min(size, pending.size - at))
        found = bytearray(size)
        kept = os.pread(file, min(size, max(0, self.kept[stat.st_ino] - at)), at)
        found[: len(kept)] = kept
        for begin, data in pending.pieces:
            low, high = max(at, begin), min(at + size, begin + len(data))
            if low < high:
                found[low - at : high - at] = data[low - begin : high - begin]
        return bytes(found)

    def write(self, path, data, at, info):
        _, pending = self.of(info.fh)
        pending.pieces.append((at, bytes(data)))
        pending.size = max(pending.size, at + len(data))
        if info.fh in self.synced:
            self.flush_file(info.fh)
        return len(data)

    def cut(self, file, size):
        number, pending = self.of(file)
        pending.cut(size)
        self.kept[number] = min(self.kept[number], size)

    def truncate(self, path, size, info=None):
        if info:
            self.cut(info.fh, size)
            return
        file = os.open(self.below(path), os.O_RDWR)
        self.cut(file, size)
        os.close(file)

    def fsync(self, path, datasync, info):
        self.flush_file(info.fh)

    def release(self, path, info):
        self.synced.discard(info.fh)
        os.close(info.fh)

    # Names.

    def getattr(self, path, info=None):
        stat = os.fstat(info.fh) if info else os.lstat(self.below(path))
        names = ("st_mode", "st_nlink", "st_uid", "st_gid", "st_size")
        found = {name: getattr(stat, name) for name in names}
        found |= {f"st_{one}time": getattr(stat, f"st_{one}time_ns") for one in "amc"}
        pending = self.pending.get(stat.st_ino)
        if pending:
            found["st_size"] = pending.size
        return found

    def readdir(self, path, fh):
        return [".", "..", *os.listdir(self.below(path))]

    def mkdir(self, path, mode):
        os.mkdir(self.below(path), mode)

    def rmdir(self, path):
        os.rmdir(self.below(path))

    def unlink(self, path):
        self.forget(self.below(path))
        os.unlink(self.below(path))

    def rename(self, old, new):
        self.forget(self.below(new))
        os.rename(self.below(old), self.below(new))

    def forget(self, path):
        try:
            number = os.lstat(path).st_ino
        except FileNotFoundError:
            return
        self.pending.pop(number, None)
        self.kept.pop(number, None)

    def chmod(self, path, mode):
        os.chmod(self.below(path), mode)

    def utimens(self, path, times=None):
        os.utime(self.below(path), ns=times)

    def statfs(self, path):
        stat = os.statvfs(self.below(path))
        names = ("f_bavail", "f_bfree", "f_blocks", "f_bsize", "f_favail", "f_ffree", "f_files", "f_flag", "f_frsize", "f_namemax")
        return {name: getattr(stat, name) for name in names}

    def access(self, path, mode):
        if not os.access(self.below(path), mode):
            raise fuse.FuseOSError(errno.EACCES)


if __name__ == "__main__":
    layer = Volatile(sys.argv[1])
    signal.signal(signal.SIGUSR1, layer.soon)
    signal.signal(signal.SIGUSR2, layer.back)
    # The kernel keeps nothing of its own: what it shows is what is here.
    asked = {"foreground": True, "nothreads": True, "direct_io": True, "attr_timeout": 0, "entry_timeout": 0}
    fuse.FUSE(layer, sys.argv[2], raw_fi=True, **asked)
