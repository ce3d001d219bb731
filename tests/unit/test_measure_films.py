"""``slipstitch measure``: films of the example, altered, read by the instrument that ships."""

import json

from support import example_film

from slipstitch.cli.main import main
from slipstitch.measure.measurement_files import MeasuredPair
from slipstitch.measure.measuring import MeasuringBench


def test_a_camera_outside_the_range_raises_the_alarm_although_the_images_do_not(
    tmp_path, capsys, monkeypatch
):
    videos = []
    measure = MeasuringBench.measure

    def kept(*arguments, **options):
        videos.append(measure(*arguments, **options))
        return videos[-1]

    monkeypatch.setattr(MeasuringBench, "measure", kept)
    film, camera = example_film.rolled(tmp_path, 25)
    words = ["measure", str(film), "--camera", str(camera), "--force"]
    out = [f"--{kind}={tmp_path / 'x'}.{kind}" for kind in ("json", "csv")]
    assert main([*words, *out, f"--out={tmp_path / 'x.html'}"]) == 3
    reason = (
        "the pose of the camera is outside the training range of the instrument: roll +25.1 "
        "degrees (trained on -2.1 ... +2)"
    )
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == f"ALARM: {reason}: these numbers are not reliable"
    told = json.loads((tmp_path / "x.json").read_text())
    assert told["alarm"] and told["alarm_reason"] == reason
    assert not told["alarm_of_images"]
    assert reason in (tmp_path / "x.csv").read_text().splitlines()[1]
    page = (tmp_path / "x.html").read_text()
    assert f"<b>Alarm:</b> {reason}" in page and "No alarm" not in page
    # Of several films, it has no part in the combined value.
    assert MeasuredPair(videos, []).together is None
