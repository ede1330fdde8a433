from .fields import propagate as propagate
from .operators import apply as apply
from .steps import apply_step as apply_step
