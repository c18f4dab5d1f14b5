"""The pages say what the axis says, load nothing from outside, and show the paper's rule by name."""

import re
from dataclasses import replace
from datetime import timedelta

import httpx
import numpy as np
import pytest

from monitor_core.preload.relative import ConditionLaw
from monitor_core.recordings import open_session
from service.cli.demo import CALIBRATION, demonstration_axis, replay_bundled
from service.cli.remote.client import Client
from service.cli.remote.server import embedded_service
from service.operations.monitoring.history import HealthyFrequency, History
from service.operations.monitoring.long_run import spectra_of, unexplained
from service.settings import BUNDLED_SESSIONS, Settings
from service.store.database import Database
from tests.service.conftest import START, axial_frequency, running_service, simulated_measurement


def test_axis_page_tells_state_baseline_alarm_and_the_papers_rule(tmp_path) -> None:
    settings = Settings(data_dir=tmp_path, port=0)
    with embedded_service(settings) as url, Client(url) as client:
        configuration = demonstration_axis(BUNDLED_SESSIONS)
        client.put(f"/v1/axes/{CALIBRATION}", {"name": "calibration", "configuration": configuration})
        replay_bundled(client, BUNDLED_SESSIONS, CALIBRATION, "calibration")
        fitted = client.post(f"/v1/axes/{CALIBRATION}/calibrations", {"measurements": {}, "comment": ""})
        client.put("/v1/axes/x", {"name": "Axis X", "configuration": configuration})
        own = client.post("/v1/axes/x/calibrations", {"document": fitted["document"], "comment": ""})
        client.post(f"/v1/axes/x/calibrations/{own['id']}/activate", {"reason": "test"})
        with open_session(BUNDLED_SESSIONS / "sudden-loss.session.h5") as session:
            for name in session.measurements:
                client.post_measurement("x", session.windows_of(name))
        paths = ("/axes/x", "/", f"/axes/{CALIBRATION}")
        page, fleet, stored = (httpx.get(url + path, timeout=60.0).text for path in paths)
    page, fleet, stored = (" ".join(text.split()) for text in (page, fleet, stored))
    assert re.search('<span class="state alarm" id="state">.*?</span> alarm</span>', page)
    page, stored = (re.sub(r"<[^>]+>", "", text) for text in (page, stored))
    assert "Rule of the paper" in page
    assert "told apart" in page
    assert "not told apart" not in page
    assert re.search(r"baseline of 2\d sessions", page)
    assert "False alarms: stated 1 a year; the history of this axis says nothing yet: 70 sessions are needed" in page
    assert "The baseline has not seen other seasons than those" in page
    assert "whether it goes on is known after ten sessions" in page  # a step is no rate
    assert "N a year" not in page
    assert "N a day" not in page
    assert "N below the baseline" in page
    assert "What the last interval is made of" in page
    assert "95 % coverage interval of" in page
    assert "what another day changes" in page
    # as later measurements are judged, with the friction of its windows
    assert "friction-torque" in [witness["name"] for witness in fitted["document"]["witnesses"]]
    assert f"None in force: number {fitted['id']} is stored." in stored
    assert fleet.index("Axis X") < fleet.index("calibration")  # worst first
    for text in (page, fleet):
        assert "http://" not in text
        assert "https://" not in text


def test_a_picture_is_drawn_anew_when_what_it_shows_has_changed(tmp_path) -> None:
    rng, lubricated = np.random.default_rng(4), 'class="event work"'
    with running_service(tmp_path) as api:
        api.register("axis", windows_per_measurement=2, minimum_averages=2)
        path = "/v1/axes/axis/calibrations"
        document = api.http.get(f"{path}/{api.calibrate('axis')}").json()["document"]
        document["between_sessions_relative"] = 3e-4
        number = api.http.post(path, json={"document": document, "comment": "of one session"}).json()["id"]
        assert api.http.post(f"{path}/{number}/activate", json={"reason": "test"}).is_success
        for number in (1, 2, 3):
            at = START + timedelta(days=number)
            windows = simulated_measurement(rng, f"m{number}", n_windows=2, started_at=at)
            api.accept("axis", [replace(w, conditions=replace(w.conditions, payload_mass=None)) for w in windows])
            pages = [api.http.get("/axes/axis").text for _ in range(2)]
            marks = [sorted(set(re.findall(r'measurements/(\d+)" tabindex', page))) for page in pages]
            assert marks == [[str(n) for n in range(1, number + 1)]] * 2
        assert lubricated not in pages[-1]
        for page in (pages[-1], api.http.get(f"/axes/axis/measurements/{marks[-1][-1]}").text):
            assert re.search(r"[ >]± [\d.]+ N; with the payload ± [\d.]+ N\.", page)
        entry = {"at": (START + timedelta(days=2)).isoformat(), "who": "Anna", "kind": "lubricated"}
        assert api.http.post("/v1/axes/axis/maintenance", json=entry).status_code == 201
        page = api.http.get("/axes/axis").text
        in_german = api.http.get("/axes/axis", headers={"accept-language": "de"}).text
    assert lubricated in page
    assert ">geschmiert<" in in_german
    assert ">geschmiert<" not in page


def test_preloads_set_on_purpose_are_no_history(tmp_path) -> None:
    rng = np.random.default_rng(7)
    with running_service(tmp_path) as api:
        api.register("axis", windows_per_measurement=2, minimum_averages=2)
        api.calibrate("axis")
        for number, preload in enumerate((100.0, 150.0, 200.0, None, None)):
            api.accept(
                "axis",
                simulated_measurement(
                    rng, f"m{number}", n_windows=2, preload=preload or 300.0, set_preload=preload,
                    started_at=START + timedelta(days=number),
                ),
            )  # fmt: skip
            if number == 2:
                before = [api.http.get(path).text for path in ("/axes/axis", "/")]
        page, fleet = (api.http.get(path).text for path in ("/axes/axis", "/"))
        empty = api.http.get("/axes/axis", params={"from": "2020-01-01T00:00:00Z", "to": "2020-02-01T00:00:00Z"}).text
    assert "?range=all" in empty  # the chart of a stretch without any leads to the others
    assert [("set on purpose" in text, "<svg" in text) for text in before] == [(True, False)] * 2
    assert "set on purpose" not in fleet
    assert sorted(set(re.findall(r'measurements/(\d+)" tabindex', page))) == ["4", "5"]
    (course,) = re.findall(r'class="spark" d="([^"]*)"|d="([^"]*)" class="spark"', fleet)
    assert len(re.findall(r"[\d.]+ [\d.]+", "".join(course))) == 2


@pytest.mark.parametrize("calibrated", [True, False])
def test_the_mode_over_time_is_that_at_one_position(tmp_path, calibrated: bool) -> None:
    rng, places = np.random.default_rng(8), (400.0, 600.0, 450.0, 550.0, 500.0, 420.0, 580.0, 480.0, 520.0, 500.0)
    preloads = (*(len(places) - 3) * (300.0,), 250.0, 200.0, 150.0)
    with running_service(tmp_path) as api:
        api.register("axis", windows_per_measurement=4)
        if calibrated:
            api.calibrate("axis")
        for number, (place, preload) in enumerate(zip(places, preloads, strict=True)):
            at = START + timedelta(days=number)
            of_day = {"preload": preload, "position_mm": place, "n_windows": 4, "started_at": at}
            api.accept("axis", simulated_measurement(rng, f"m{number}", **of_day))
        database = Database(f"sqlite:///{tmp_path / 'preload.db'}")
        spectra = spectra_of(database, "axis", History(database).of("axis").healthy)
        page = api.http.get("/axes/axis/long-run").text
    expected = [axial_frequency(preload, 0.5) for preload in preloads[::-1]]
    raw = np.array([spectrum.point.frequency_hz for spectrum in spectra])
    assert np.ptp(raw[3:]) > 4.0
    # without a calibration the law of the position is learnt from seven measurements
    assert [spectrum.mode for spectrum in spectra] == pytest.approx(expected, abs=0.15 if calibrated else 1.5)
    for spectrum in spectra:  # the response goes with its mode
        peak = spectrum.frequency[np.nanargmax(spectrum.magnitude)]
        assert peak == pytest.approx(spectrum.mode, abs=1.0)
        assert spectrum.coherence is not None
        assert spectrum.coherence > 0.9
        assert spectrum.unexplained is not None
        assert spectrum.unexplained < 0.1
    assert len(re.findall("<figcaption>", page)) == 2  # its windows tell no friction torque
    assert len(re.findall("[ML]", re.findall(r'<path d="([^"]*)" class="mode"', page)[0])) == len(places)


def test_what_a_mode_leaves_of_a_response_is_what_was_added_to_it() -> None:
    frequency, mode, damping = np.linspace(170.0, 190.0, 41), 180.0, 0.01
    alone = frequency**2 / (mode**2 - frequency**2 + 2j * damping * mode * frequency)
    assert unexplained(frequency, (3.0 - 1.0j) * alone + 0.7j, mode, damping) == pytest.approx(0.0, abs=1e-12)
    rng = np.random.default_rng(3)
    added = rng.normal(size=41) + 1j * rng.normal(size=41)
    share = float(np.linalg.norm(added) / np.linalg.norm(alone + added))
    left = unexplained(frequency, alone + added, mode, damping)
    assert left == pytest.approx(share, rel=0.1)  # two of 41 coefficients follow the noise
    assert unexplained(frequency[:3], alone[:3], mode, damping) is None


def test_a_mode_beyond_the_law_of_the_position_is_drawn_as_it_is(tmp_path) -> None:
    rng = np.random.default_rng(9)
    steep = HealthyFrequency(ConditionLaw((1.0, 0.0, 0.0, 0.0), (0.0,) * 16, (0.0,) * 4), level=1.0)
    with running_service(tmp_path) as api:
        api.register("axis", windows_per_measurement=4)
        for day, place in enumerate((400.0, 500.0, 600.0)):
            of_day = {"position_mm": place, "n_windows": 4, "started_at": START + timedelta(days=day)}
            api.accept("axis", simulated_measurement(rng, f"m{day}", **of_day))
        beyond, usual, _ = spectra_of(Database(f"sqlite:///{tmp_path / 'preload.db'}"), "axis", steep)
    for spectrum in (beyond, usual):  # 1/f² - 1 s²/m · 0.1 m < 0 at 600 mm
        assert spectrum.mode == pytest.approx(spectrum.point.frequency_hz, rel=1e-12)
