"""From a grey frame to a semantic map (§2.2): the pix2pix network, and classical baselines with the same call.

`load_segmenter(name)` gives a `Segmenter`. The names in `SEGMENTERS`:

- `pix2pix`: the shipped network. It looks at tiles of the frame, then more closely at each object.
- `otsu`: Otsu's two thresholds (1979; scikit-image's `threshold_multiotsu`) on the frame's 3 × 3 median. Above the
  upper one is highlight, at or below the lower one is shadow, and background lies between.
- `otsu3`: the same on the frame without a median; named for its three classes.
- `median-otsu`: the same on the frame's 5 × 5 median.
- `otsu1`: Otsu's single threshold (`threshold_otsu`) on the frame without a median: highlight above it, no shadow.
- `none`: no segmentation. The semantic map is the grey frame itself; for labels it is cut at 1/4 and 3/4.

With a mask, the thresholds are those of the pixels inside it (though a median also uses pixels outside). Pixels outside
the mask are background, except in the map of `none`, which is the frame everywhere.
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
