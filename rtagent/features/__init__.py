"""Feature coders: from a state to the indices (and values) of its active features."""

from rtagent.features.adaptive import AdaptiveKanerva
from rtagent.features.coder import FeatureCoder, Moving, Remembering
from rtagent.features.inputs import Composed, DataTrace, Inputs, Traced
from rtagent.features.kanerva import KanervaCoding, SelectiveKanerva
from rtagent.features.paired import PairedCoder, PairedVector
from rtagent.features.sparse import SparseMemory
from rtagent.features.tables import Binned, OneHot, Tabular
from rtagent.features.tiles import TileCoding
from rtagent.features.tilings import Tilings

__all__ = [
    "AdaptiveKanerva",
    "Binned",
    "Composed",
    "DataTrace",
    "FeatureCoder",
    "Inputs",
    "KanervaCoding",
    "Moving",
    "OneHot",
    "PairedCoder",
    "PairedVector",
    "Remembering",
    "SelectiveKanerva",
    "SparseMemory",
    "Tabular",
    "TileCoding",
    "Tilings",
    "Traced",
]
