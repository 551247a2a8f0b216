"""Checkpoints of a library build: finished parts, stored beside the library until it is complete."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes, write_text
from frogkick.library.transitions import Failed, Transitions

_FORMAT = "frogkick library parts"


def checkpoint_folder(out: Path) -> Path:
    """Folder of the checkpoints of a library."""
    return out.with_name(out.name + ".parts")


class Checkpoints:
    """Folder ``OUT.parts`` of one build: a build that is started again resumes from the finished parts."""

    def __init__(self, out: Path, job: bytes, name: str = "", keep_others: bool = False) -> None:
        """Open the folder; the first part creates it.

        Args:
            out: the library's file.
            job: everything that its content depends on.
            name: of the job, for people.
            keep_others: raise if there are parts of another job, instead of deleting them.

        Raises:
            InputError: the folder is none of ours, or there are parts of another job.
        """
        self.folder = checkpoint_folder(out)
        self._name = name
        self._key = hashlib.sha256(job).hexdigest()
        if not self.folder.exists():
            return
        key, whose = self._found()
        if key == self._key:
            return
        if keep_others and key and any(self.folder.glob("*.npz")):
            raise InputError(
                f"{str(self.folder)!r} holds finished parts of another library ({whose}), this one is "
                f"{name}: build that one to its end, choose another --out, or delete the folder"
            )
        self.remove()

    def _found(self) -> tuple[str, str]:
        """Key and name of the job whose parts are there; two empty texts if unknown."""
        try:
            text = json.loads((self.folder / "job.json").read_text(encoding="utf-8"))
            if str(text["format"]).startswith(_FORMAT):
                return str(text["key"]), str(text.get("name", "by an earlier version"))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        if self.folder.is_dir() and all(file.suffix == ".npz" for file in self.folder.iterdir()):
            return "", ""  # stopped before job.json was written
        raise InputError(
            f"{str(self.folder)!r} is in the way of the library's parts and is none of ours: "
            "move it or choose another --out"
        )

    def _file(self, index: int) -> Path:
        return self.folder / f"{index:06d}.npz"

    def save(self, index: int, part: Transitions) -> None:
        """Write a part atomically."""
        if not self.folder.exists():
            about = {"format": _FORMAT, "key": self._key, "name": self._name}
            write_text(self.folder / "job.json", json.dumps(about) + "\n")
        content = io.BytesIO()
        np.savez(
            content,
            velocity=part.velocity_body,
            previous=part.previous,
            rows=part.rows,
            recorded=part.recorded,
            failed=np.array([(f.state, f.action) for f in part.failed], dtype=np.int64).reshape(-1, 2),
            reasons=np.array([f.reason for f in part.failed], dtype=np.str_),
        )
        write_bytes(self._file(index), content.getvalue())

    def load(self, index: int) -> Transitions | None:
        """A part, or None if it is missing or damaged."""
        try:
            content = io.BytesIO(self._file(index).read_bytes())
            with np.load(content, allow_pickle=False) as part:
                reasons: list[str] = part["reasons"].tolist()
                places: list[list[int]] = part["failed"].tolist()
                rows: Float64 = part["rows"]
                failed = tuple(Failed(s, a, r) for (s, a), r in zip(places, reasons, strict=True))
                return Transitions(part["velocity"], part["previous"], rows, part["recorded"], failed)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
