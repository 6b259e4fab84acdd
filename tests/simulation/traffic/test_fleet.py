import numpy as np
import pytest

from sightline.simulation.traffic.crowd import Fleet

CLASSES = ("Car", "Van", "Truck", "Tram", "Misc", "Pedestrian", "Person_sitting", "Cyclist")


@pytest.mark.parametrize("name", CLASSES)
def test_a_fleet_has_models_of_every_class(name):
    model = Fleet().draw(np.random.default_rng(0), name, 1.0)
    assert model.class_name == name
    assert len(model.shape.at(0.0).faces) > 0


@pytest.mark.parametrize("name", CLASSES)
def test_fleets_with_the_same_randomness_draw_the_same(name):
    drawn = []
    for _ in range(2):
        fleet, rng = Fleet(), np.random.default_rng(5)
        drawn.append([fleet.draw(rng, name, 1.0) for _ in range(6)])
    for first, second in zip(*drawn, strict=True):
        assert first.size_lwh == second.size_lwh
        one, other = first.shape.at(0.3), second.shape.at(0.3)
        assert one.vertices.tobytes() == other.vertices.tobytes()
        assert one.colors.tobytes() == other.colors.tobytes()


def test_no_two_cars_of_a_street_are_equal_though_they_share_designs():
    fleet, rng = Fleet(), np.random.default_rng(0)
    models = [fleet.draw(rng, "Car", 0.0) for _ in range(40)]
    assert len({model.size_lwh for model in models}) == 40
    shapes = {model.shape.at(0.0).faces.tobytes() for model in models}
    assert 8 < len(shapes) < 40
