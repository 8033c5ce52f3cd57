"""The object's silhouette at full resolution, cut along edges of the picture."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from models.foreground import Foreground, link_masks, locate_foreground

_BAND = 0.02  # of the picture's longer side, on both sides of the found outline: where the cut may run
_AROUND = 3  # bands around the object: whose colours are the background's
_STEPS = 3  # of GrabCut
_RIM, _NEAR = 2.0, 9  # [px]: where pixels mix two colours, and the box of their surroundings whose means these are
_LEAST_CONTRAST = 5.0  # of 255


def sharp_foreground(frames: UInt8[np.ndarray, "T H W 3"]) -> Foreground:
    """The silhouette of `locate_foreground`, its outline moved to edges of the full picture.

    GrabCut (Rother et al. 2004, as in OpenCV) cuts within a band around the outline, by the colours inside and around.
    Pixels of the cut that mix both belong to the object if it covers more than half of them.
    """
    found = locate_foreground(frames)
    if not found.confidence or not found.mask.any():
        return found
    cut = np.stack([_cut(image, mask) for image, mask in zip(frames, found.mask, strict=True)])
    linked = link_masks(cut, found.mask.mean(axis=0, dtype=np.float32))
    return Foreground(mask=linked, source=found.source, confidence=found.confidence)


def _cut(image: UInt8[np.ndarray, "H W 3"], mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    if not mask.any():
        return mask
    band = max(2, round(_BAND * max(mask.shape)))
    inside, outside = _depths(mask)
    rows, columns = (np.flatnonzero((outside < (1 + _AROUND) * band).any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    labels = np.where(mask, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[inside > band] = cv2.GC_FGD
    labels[outside > band] = cv2.GC_BGD
    labels = np.ascontiguousarray(labels[window])
    cv2.setRNGSeed(0)  # of the first clusters of colours
    models = np.zeros((1, 65)), np.zeros((1, 65))
    part, mode = np.ascontiguousarray(image[window][..., ::-1]), cv2.GC_INIT_WITH_MASK
    cv2.grabCut(part, labels, (0, 0, 0, 0), *models, _STEPS, mode)
    out = np.zeros_like(mask)
    out[window] = _more_than_half(image[window], np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)))
    return out


def _depths(mask: Bool[np.ndarray, "h w"]) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Distances [px] of the pixels inside a mask from those outside, and the other way round; zero elsewhere."""
    inside, outside = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 3) for part in (mask, ~mask))
    return inside, outside


def _more_than_half(image: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The mask, on whose rim a pixel counts if its colour lies nearer to those inside than to those outside."""
    colours = image.astype(np.float32)
    inside, outside = _depths(mask)
    means, known = [], (inside <= _RIM) & (outside <= _RIM)
    for part in (inside > _RIM, outside > _RIM):
        share = cv2.blur(part.astype(np.float32), (_NEAR, _NEAR))
        means.append(cv2.blur(colours * part[..., None], (_NEAR, _NEAR)) / np.maximum(share, 1e-6)[..., None])
        known &= share > 1e-3
    ours, theirs = means
    along = ours - theirs
    covered = ((colours - theirs) * along).sum(axis=-1) / np.maximum(np.square(along).sum(axis=-1), _LEAST_CONTRAST**2)
    return np.where(known, covered > 0.5, mask)
