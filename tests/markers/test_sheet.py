"""Printed sheets are true to scale, and are written completely or not at all."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from drawn_frames import run
from PIL import Image, PdfParser

from shape_obs.calibration import Board
from shape_obs.markers import find_markers


class TestSheets:
    def pictures(self, path: Path) -> list[tuple[np.ndarray, float]]:
        """Return each page as pixels, and the number of pixels per printed millimetre."""
        if path.suffix == ".png":
            with Image.open(path) as picture:
                return [(np.asarray(picture.convert("L")), picture.info["dpi"][0] / 25.4)]
        return [pdf_page(path, number) for number in range(len(pdf(path).pages))]

    @pytest.mark.parametrize("suffix", [".pdf", ".png"])
    @pytest.mark.parametrize("paper", ["a4", "letter"])
    def test_true_to_scale(self, tmp_path, suffix, paper):
        path = tmp_path / f"sheet{suffix}"
        assert run("markers", "-o", path, "--paper", paper, "--size", 55, "--ids", 4, 17, 23) == 0
        ((page, per_mm),) = self.pictures(path)
        width, height = {"a4": (210, 297), "letter": (215.9, 279.4)}[paper]
        assert np.array(page.shape[::-1]) / per_mm == pytest.approx((width, height), abs=0.05)
        found = find_markers(page)
        assert sorted(found) == [4, 17, 23]
        for corners in found.values():
            sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1) / per_mm
            assert sides == pytest.approx(np.full(4, 55), abs=0.05)
        assert [each.name for each in tmp_path.iterdir()] == [path.name]

    def test_what_does_not_fit_goes_to_further_pages_of_a_pdf(self, tmp_path, capsys):
        assert run("markers", "-o", tmp_path / "s.pdf", "--size", 100, "--ids", 0, 1, 2) == 0
        assert [sorted(find_markers(page)) for page, _ in self.pictures(tmp_path / "s.pdf")] == [[0], [1], [2]]
        assert run("markers", "-o", tmp_path / "s.png", "--size", 100, "--ids", 0, 1, 2) == 1
        assert "3 pages do not fit into a PNG" in capsys.readouterr().err
        assert not (tmp_path / "s.png").exists()

    def test_the_board(self, tmp_path):
        path = tmp_path / "board.pdf"
        assert run("markers", "--charuco", "-o", path) == 0
        ((page, per_mm),) = self.pictures(path)
        ids, pixels = Board().find(page[::2, ::2])
        assert len(ids) == 24
        places = Board().corners[ids, :2]
        both = np.linalg.norm(pixels[0] - pixels[-1]) * 2 / per_mm, 1000 * np.linalg.norm(places[0] - places[-1])
        assert both[0] == pytest.approx(both[1], rel=0.002)

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["-o", "sheet.gif"], "--out: expected a file named *.pdf or *.png"),
            (["--size", 300], "a marker of 300 mm does not fit on a4 paper: give at most 142 mm"),
            (["--ids", 0, 99], "markers of '4x4_50' have the ids 0 to 49, got 99"),
            (["--charuco", "--size", 40], "--ids and --size are for single markers; with --charuco use --board"),
            (["--charuco", "--board", 9, 6, 40, 30, "--dictionary", "4x4_100"], "the board of 360 x 240 mm does not"),
        ],
    )
    def test_errors(self, tmp_path, monkeypatch, capsys, words, message):
        monkeypatch.chdir(tmp_path)
        assert run("markers", *words) == 2
        assert message in capsys.readouterr().err
        assert not list(tmp_path.iterdir())


def pdf(path: Path) -> PdfParser.PdfParser:
    return PdfParser.PdfParser(str(path), mode="rb")


def pdf_page(path: Path, number: int) -> tuple[np.ndarray, float]:
    """Return a page's picture and its pixels per millimetre; a PDF's units are 1/72 inch."""
    with pdf(path) as document:
        page = document.read_indirect(document.pages[number])
        box = page[b"MediaBox"]
        (reference,) = page[b"Resources"][b"XObject"].values()
        picture = document.read_indirect(reference)
        width, height = picture.dictionary[b"Width"], picture.dictionary[b"Height"]
        image = Image.open(io.BytesIO(fax_as_tiff(picture.buf, width, height))).convert("L")
        return 255 - np.asarray(image), width / (float(box[2]) / 72 * 25.4)


def fax_as_tiff(data: bytes, width: int, height: int) -> bytes:
    """Return CCITT group 4 data as a TIFF file that Pillow reads."""
    tags = [(256, 4, width), (257, 4, height), (258, 3, 1), (259, 3, 4), (262, 3, 0), (273, 4, 122), (277, 3, 1)]
    tags += [(278, 4, height), (279, 4, len(data))]
    head = struct.pack("<2sHLH", b"II", 42, 8, len(tags))
    return head + b"".join(struct.pack("<HHLL", tag, kind, 1, value) for tag, kind, value in tags) + b"\0\0\0\0" + data
