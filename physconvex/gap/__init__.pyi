from .base.base_fit import fit_baseline as fit_baseline
from .base.box_mesh import with_plane as with_plane
from .base.model import EffectModel as EffectModel
from .base.rough_fit import rough_baseline as rough_baseline
from .conditions.setting import find_setting as find_setting
from .diagnosis import diagnose as diagnose
from .effects.catalogue import (
    DEFAULT_EFFECTS as DEFAULT_EFFECTS,
    EFFECT_NAMES as EFFECT_NAMES,
    applicable as applicable,
    choose as choose,
)
from .effects.effect import (
    IN_FLIGHT as IN_FLIGHT,
    Dose as Dose,
    Effect as Effect,
    Patches as Patches,
    Situation as Situation,
    Source as Source,
)
from .effects.motion import MotionCorrection as MotionCorrection, PointMotion as PointMotion
from .effects.world import rotation_vector_matrix as rotation_vector_matrix
from .errors.error_model import error_model as error_model
from .errors.numerical_differences import correction_of as correction_of, numerical_differences as numerical_differences
from .errors.score_test import (
    ErrorModel as ErrorModel,
    Projector as Projector,
    Score as Score,
    score_effect as score_effect,
)
from .judgement.naming import NamedDose as NamedDose, NamedEffect as NamedEffect, Verdict as Verdict
from .location.where import Part as Part, Where as Where
from .options import GapOptions as GapOptions
from .page.report import GapReport as GapReport, ImprovedTwin as ImprovedTwin
from .search.hypothesis import Hypothesis as Hypothesis
from .shrinkage import HowFar as HowFar
from .thresholds import VERDICT as VERDICT, thresholds_table as thresholds_table
