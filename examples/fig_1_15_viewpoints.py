"""Figure 1.15: viewpoints on the left and on the right of the lens, objects at three depths."""

from common import begin
from extended import QUICK
from parallax import draw

draw(begin(__doc__, __file__, quick=QUICK), 1, ("left", "right"))
