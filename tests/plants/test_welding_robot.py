import control
import numpy as np

from plants.welding_robot import WELDING_ROBOT


def test_transfer_function_is_the_papers_reduced_model():
    """[2] eq. (9): G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67)."""
    G = control.ss2tf(control.ss(*WELDING_ROBOT.linearize([0.0, 0.0], [0.0])))
    np.testing.assert_allclose(G.num[0][0], [1.0, 2.3], rtol=1e-9)
    np.testing.assert_allclose(G.den[0][0], [1.0, 6.6, 1.67], rtol=1e-9)
