"""CSV and KML."""

import gzip
import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from gnssins import export
from gnssins.errors import InputError
from short_flight import result

KML = "{http://www.opengis.net/kml/2.2}"


def empty():
    r = result()
    names = ("t_ns", "lla", "v_n", "rpy", "q_nb", "sd", "x", "x_sd")
    return replace(r, **{name: getattr(r, name)[:0] for name in names})


def test_csv_reads_back_to_the_navigation_table(tmp_path):
    table = result().navigation
    again = pl.read_csv(result().to_csv(tmp_path / "navigation.csv"))
    assert again.columns == table.columns
    assert np.array_equal(again["time_s"], table["time_s"])
    assert np.abs(again["lat_deg"] - table["lat_deg"]).max() <= 0.51e-10
    for name in ("height_m", "v_north_m_s", "heading_deg", "sd_gyro_bias_x_deg_h"):
        assert np.allclose(again[name], table[name], rtol=1e-7, atol=1e-5), name


def test_csv_is_compressed_when_the_name_says_so(tmp_path):
    plain, packed = result().to_csv(tmp_path / "n.csv"), result().to_csv(tmp_path / "n.csv.gz")
    assert gzip.decompress(packed.read_bytes()) == plain.read_bytes()
    assert result().to_csv(tmp_path / "m.csv.gz").read_bytes() == packed.read_bytes()


def test_csv_of_measurements_leaves_matrices_out(tmp_path):
    again = pl.read_csv(export.write_csv(result().measurements, tmp_path / "m.csv"))
    assert "innovation_cov" not in again.columns
    assert again.height == result().measurements.height
    assert again["status"].to_list() == result().measurements["status"].to_list()


def test_kml_has_the_track_the_gap_and_both_ends(tmp_path):
    root = ET.parse(result().to_kml(tmp_path / "track.kml", name="A & B <1>")).getroot()
    assert root.find(f"{KML}Document/{KML}name").text == "A & B <1>"
    marks = root.findall(f".//{KML}Placemark")
    assert [mark.find(f"{KML}name").text for mark in marks] == ["Track", "Without GNSS 1", "Start", "End"]
    points = marks[0].find(f".//{KML}coordinates").text.split()
    assert len(points) == len(result())
    lon, lat, height = map(float, points[0].split(","))
    first = result().lla[0]
    assert lon == pytest.approx(math.degrees(first[1]), abs=1e-9)
    assert lat == pytest.approx(math.degrees(first[0]), abs=1e-9)
    assert height == pytest.approx(first[2], abs=1e-3)
    gap = marks[1].find(f".//{KML}coordinates").text.split()
    assert len(gap) == 501


def test_kml_is_thinned_and_keeps_both_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(export, "KML_POINTS", 100)
    root = ET.parse(result().to_kml(tmp_path / "track.kml")).getroot()
    points = root.find(f".//{KML}coordinates").text.split()
    assert len(points) == 100
    assert root.find(f"{KML}Document/{KML}name").text == "track"
    ends = [
        mark.find(f".//{KML}coordinates").text.strip() for mark in root.findall(f".//{KML}Placemark")[-2:]
    ]
    assert [points[0], points[-1]] == ends


def test_an_empty_result_has_no_track(tmp_path):
    with pytest.raises(InputError, match="without epochs"):
        empty().to_kml(tmp_path / "track.kml")
    assert repr(empty()) == "Result(empty)"
    assert not list(tmp_path.iterdir())
