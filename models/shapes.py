"""Clean binary masks and follow one of their parts through time."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32


def clean_mask(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Open, close and fill holes."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, cross)
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return cv2.drawContours(np.zeros_like(closed), outlines, -1, 1, cv2.FILLED) > 0


def link_masks(masks: Bool[np.ndarray, "T H W"], weight: Float32[np.ndarray, "H W"]) -> Bool[np.ndarray, "T H W"]:
    """Keep in each frame the component that continues its neighbour's, outward from the heaviest.

    A component weighs what `weight` sums to inside it.
    """
    parts = [cv2.connectedComponents(mask.astype(np.uint8), connectivity=8) for mask in masks]
    weights = [np.bincount(labels.ravel(), weight.ravel(), minlength=2)[1:] for _, labels in parts]
    start = int(np.argmax([heavy.max() for heavy in weights]))
    out = np.zeros_like(masks)
    for order in (range(start, len(masks)), range(start - 1, -1, -1)):
        previous = out[start] if order.step < 0 else None
        for k in order:
            count, labels = parts[k]
            if count < 2:
                continue
            merit = weights[k]
            if previous is not None:
                near = cv2.dilate(previous.view(np.uint8), np.ones((9, 9), np.uint8)) > 0
                merit = np.bincount(labels[near], weight[near], minlength=count)[1:] + 0.2 * merit
            out[k] = labels == 1 + int(merit.argmax())
            previous = out[k]
    return out
