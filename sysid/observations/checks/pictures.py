"""Pictures that are empty, broken, or not of one size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from sim_core.errors import RecordingError
from sysid.observations.checks.finding import Finding
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def pictures(recording: Recording) -> Iterator[Finding]:
    """A look at some pictures of each camera."""
    for name, stream in recording.images.items():
        chosen = np.unique(
            np.linspace(0, len(stream) - 1, min(OBSERVATIONS.pictures_looked_at, len(stream))).astype(int)
        )
        broken: list[tuple[float, str]] = []
        blank: list[float] = []
        sizes: Counter[tuple[int, int]] = Counter()
        for k in chosen:
            try:
                image = stream.image(int(k))
            except RecordingError as error:
                broken.append((float(stream.t[k]), error.problem))
                continue
            sizes[(image.shape[1], image.shape[0])] += 1
            if float(image.std()) < OBSERVATIONS.blank_grey_sd:
                blank.append(float(stream.t[k]))
        looked = f"of {len(chosen)} pictures that were looked at"
        if broken:
            yield Finding(
                "broken_pictures",
                stream.topic,
                "warning",
                f"{len(broken)} {looked} cannot be decoded, the first at {broken[0][0]:.3f} s: {broken[0][1]}",
                "Broken pictures are skipped; record png, jpeg, mono8, rgb8 or bgr8.",
                times=tuple(t for t, _ in broken),
                part=name,
            )
        if blank:
            yield Finding(
                "blank_pictures",
                stream.topic,
                "warning",
                f"{len(blank)} {looked} show nothing (grey levels within {OBSERVATIONS.blank_grey_sd:g} of each "
                f"other), the first at {blank[0]:.3f} s.",
                "Look at exposure, light and the cap of the lens.",
                times=tuple(blank),
                bound=OBSERVATIONS.blank_grey_sd,
                part=name,
            )
        if len(sizes) > 1:
            listing = ", ".join(f"{w} x {h} px ({count})" for (w, h), count in sizes.most_common())
            yield Finding(
                "picture_sizes",
                stream.topic,
                "warning",
                f"The pictures are not of one size: {listing}.",
                "Record one mode of the camera on a topic.",
                part=name,
            )
