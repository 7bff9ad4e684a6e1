"""From a grey frame to a semantic map (§2.2): the pix2pix network, and classical baselines behind the same call.

`load_segmenter(name)` gives a `Segmenter`. The names in `SEGMENTERS`:

- `pix2pix`: the shipped network, through tiles of the frame and then a closer look at each object.
- `otsu`: Otsu's two thresholds (1979, as scikit-image's `threshold_multiotsu` finds them) on the frame's 3 × 3 median:
  above the upper one is highlight, at the lower one or below it shadow, between them background.
- `otsu3`: the same on the frame as it is: three classes, hence the name. `median-otsu`: the same on its 5 × 5 median.
- `otsu1`: Otsu's one threshold (`threshold_otsu`) on the frame as it is: highlight above it, no shadow.
- `none`: no segmentation. Its semantic map is the grey frame itself; its labels cut that at 1/4 and 3/4.

Where there is a mask, thresholds are those of the pixels inside it (a median looks at the pixels outside, too), and all
outside is background; only the map of `none` is the frame there as well.
"""

from sonarjax.segment.classical import to_grey
from sonarjax.segment.onnx_file import export_onnx
from sonarjax.segment.rule import EVIDENCE, IdentificationRule
from sonarjax.segment.segmenters import DEFAULT_SEGMENTER, SEGMENTERS, Segmenter, check_segmenter, load_segmenter
from sonarjax.segment.tiled import segment
from sonarjax.segment.weights import GeneratorWeights

__all__ = [
    "DEFAULT_SEGMENTER", "EVIDENCE", "SEGMENTERS", "GeneratorWeights", "IdentificationRule", "Segmenter",
    "check_segmenter", "export_onnx", "load_segmenter", "segment", "to_grey",
]  # fmt: skip
