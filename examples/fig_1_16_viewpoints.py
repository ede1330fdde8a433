"""Figure 1.16: viewpoints at the top and at the bottom of the lens, objects at three depths."""

from common import begin
from extended import QUICK
from parallax import draw

draw(begin(__doc__, __file__, quick=QUICK), 0, ("top", "bottom"))
