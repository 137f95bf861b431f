"""Preferences in a file of their own, and groups by name."""

import json

import numpy as np
import pandas as pd
import pytest

from optkit.basics.documents import write_document
from optkit.basics.errors import DataError
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences


@pytest.fixture(scope="module")
def log():
    """Offers to two groups that differ in what they like; choices are made as the model says."""
    rng, rows = np.random.default_rng(0), []
    for k in range(600):
        group, km, pay = ("car", "bike")[k % 2], rng.uniform(0, 3, 2), rng.uniform(0, 8, 2)
        utility = pay - (1.0 if group == "car" else 3.0) * km + rng.gumbel(size=2)
        taken = int(utility.argmax()) if utility.max() > rng.gumbel() else -1
        rows += [
            {"situation": f"s{k}", "group": group, "km": km[i], "compensation": pay[i], "chosen": int(i == taken)}
            for i in range(2)
        ]
    return pd.DataFrame(rows)


def test_groups_by_name(log, tmp_path):
    """Names in a table or a file are the groups' in the order of the alphabet, and estimates those of numbers."""
    found = fit_preferences(Offers.from_frame(log))
    assert found.group_names == ("bike", "car")
    assert list(dict.fromkeys(found.table()["group"])) == ["bike", "car"]
    numbered = fit_preferences(Offers.from_frame(log.assign(group=(log["group"] == "car").astype(int))))
    assert numbered.weights.tolist() == found.weights.tolist()
    assert found.weights[0, 0] < -2 < found.weights[1, 0]
    log.to_csv(tmp_path / "log.csv", index=False)
    assert Offers.load(tmp_path / "log.csv").group_names == ("bike", "car")
    saved = Offers.load(Offers.from_frame(log).save(tmp_path / "log.parquet"))
    assert saved.group_names == ("bike", "car")
    with pytest.raises(DataError, match="group in row 1 is 0"):
        Offers.from_frame(log.assign(group=["car", 0] + ["bike"] * (len(log) - 2)))


def test_a_file_comes_back(log, tmp_path):
    """To the last digit; damage, another format and a later version are refused."""
    found = fit_preferences(Offers.from_frame(log))
    path = found.save(tmp_path / "preferences.json")
    again = Preferences.load(path)
    assert again.to_dict() == found.to_dict()
    assert again.group_names == found.group_names
    whole = path.read_text()
    bare = {name: entry for name, entry in json.loads(whole).items() if name != "sha256"}
    for change, message in (
        (whole.replace("bike", "boat"), "changed or damaged"),
        (whole[:-9], "holds no preferences"),
        ("[]", "holds no preferences"),
        (json.dumps({"format": "optkit preferences", "version": 2}), "has version 2"),
        (json.dumps({"format": "optkit preferences", "version": 1}), "preferences cannot be read"),
        (json.dumps({"format": "optkit preferences", "version": True}), "has version True"),
        (json.dumps({**bare, "weihgts": 1}), "an entry 'weihgts'"),
        (json.dumps({**bare, "group_names": ["bike", "bike"]}), "there twice"),
    ):
        path.write_text(change)
        with pytest.raises(DataError, match=message):
            Preferences.load(path)
    with pytest.raises(DataError, match="cannot be read"):
        Preferences.load(tmp_path / "none.json")


def test_a_sealed_file_may_say_what_cannot_be(log, tmp_path):
    """With a right digest, too: each entry is checked, and refused in one line."""
    found = fit_preferences(Offers.from_frame(log))
    plain, C = found.to_document(), np.asarray(found.covariance)
    wrong = [
        {"pooled": "false"}, {"pooled": 0}, {"pooled": True}, {"covariance": (-C).tolist()},
        {"covariance": C[:1].tolist()},
        {"covariance": C[:, :-1].tolist()}, {"covariance": [[None] * 3] * 2}, {"scale": [1.0]}, {"scale": [0.0, 1.0]},
        {"weights": [[None, 1.0]] * 2}, {"attributes": {**plain["attributes"], "pickups": 10**12}},
        {"attributes": {**plain["attributes"], "dropoffs": True}}, {"group_names": ["a"]},
    ]  # fmt: skip
    for change in wrong:
        write_document(tmp_path / "p.json", plain | change, "preferences")
        with pytest.raises(DataError) as caught:
            Preferences.load(tmp_path / "p.json")
        assert "\n" not in str(caught.value), change
