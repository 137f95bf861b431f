"""Value functions by name: one list, which refusals and studies go by."""

import pytest

from optkit.basics.errors import InputError
from optkit.models.value.catalogue import VALUES, estimator_of
from optkit.models.value.experience import Estimator
from optkit.studies.policies import POLICIES


@pytest.mark.parametrize("name", [name for name in VALUES if not name.startswith("attention")])
def test_each_name_makes_a_new_value_function(name):
    made = estimator_of(name)
    assert isinstance(made, Estimator)
    assert type(made).__name__ == VALUES[name][1]
    assert estimator_of(name) is not made
    assert estimator_of(made) is made


def test_all_that_go_by_a_name_have_it_from_the_list():
    assert {spec.value for spec in POLICIES.values()} <= {None, *VALUES}
    with pytest.raises(InputError, match="value = 'linnear' is unknown; there are") as caught:
        estimator_of("linnear")
    assert all(f'"{name}"' in str(caught.value) for name in VALUES)
