"""What differs from one device, and one tank, to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Device:
    """A device and the water it hangs in. Levels in dB are of power; `nominal` is a DIDSON in a tank.

    Numbers without a source are assumptions about a tank with a bare floor and clay bricks, made before any recognizer
    saw a frame, and kept since.
    """

    # The device.
    beam_width_ratio: float = 1.0
    """−3 dB width of a beam, there and back, over its spacing [1]: 0.3° beams 0.3° apart (Table 2)."""
    both_ways: bool = True
    """True: one lens forms the beam on the way out and back (amplitude sinc²); False: only on the way back (sinc)."""
    conical: bool = False
    """True: beams are cones, as a line array measures them; False: half-planes, as behind a lens."""
    stray_db: float = -50.0
    """Amplitude squared that leaks from any azimuth into any beam, of the main lobe's [dB]: scattering in the lens."""
    skirt_db_per_deg: float = 12.0
    """Steepness of the vertical pattern outside the aperture, there and back [dB/°] (10–14, a fit to an ARIS 3000)."""
    droop_db: float = 1.0
    """Loss at the aperture's edge against its middle [dB]: flat-topped, not perfectly flat."""
    pulse_m: float = 0.010
    """Length of the pulse in range, c·t/2 [m]: 13 µs."""
    looks: int = 1
    """Independent looks whose intensities are averaged before storing."""
    crosstalk_db: float = -35.0
    """Power that leaks from each other beam fired at once [dB]."""
    firing_period: int = 8
    """Beams fired at once are so many apart: DIDSON fires 8 sets of 12 beams."""
    gain_exponent: float = 3.0
    """n of the time-varied gain rⁿ (in power): 30 log r, made for an extended surface."""
    gain_slope_db_m: float = 0.0
    """What the gain gets wrong, growing with range [dB/m]."""
    assumed_absorption: float = 1.0
    """Absorption that the gain assumes, over the true one [1]."""
    noise_db: float = -18.0
    """Receiver noise at the end of the window, of the lit floor's median echo [dB]; grows as (r/R)²."""
    automatic_gain: float = 0.1
    """How much of a peak beyond `headroom_db` the automatic gain takes back [dB/dB]."""
    headroom_db: float = 25.0
    """A peak so far above the floor is not yet answered by the automatic gain [dB]."""
    sound_speed_ratio: float = 1.0
    """True speed of sound over the one the device assumes [1]."""
    # What it stores.
    law: str = "db"
    """Display law: `db`, `power` or `arctan`."""
    range_db: float = 45.0
    """Law `db`: dynamic range from black to white [dB]."""
    gamma: float = 0.7
    """Law `power`: exponent of amplitude [1]."""
    floor_grey: float = 0.40
    """Grey of the lit floor's median [0, 1]: where an operator sets the gain."""
    # The water and the tank.
    temperature_c: float = 15.0
    """Water temperature [°C]."""
    object_db: float = 4.0
    """Backscattering strength of the object's faces above the floor's, at equal incidence [dB]."""
    gloss_db: float = 8.0
    """Glossy lobe at normal incidence, of Lambert's part there [dB]."""
    gloss_deg: float = 8.0
    """Width of the glossy lobe: angle from the normal where it fell to 1/e [°]."""
    patch_db: float = 1.5
    """Standard deviation of the floor's brightness from patch to patch [dB]."""
    patch_m: float = 0.25
    """Size of a patch [m]."""
    ripple: float = 0.0
    """Relative amplitude of the echo's change over ripples [1], the same whichever way the crests run."""
    ripple_m: float = 0.08
    """Wavelength of ripples [m]. Each frame draws their direction."""
    texture_shape: float = 8.0
    """Shape of the Gamma-distributed texture: speckle times it is K-distributed; large is plain speckle [1]."""
    grain_m: float = 0.02
    """Size of a grain of texture [m]."""
    bounce_db: float = -13.0
    """Power that the floor reflects as a mirror would [dB]: smooth for its material, rough for a 0.8 mm wave."""
    bounce_spread_m: float = 0.005
    """Mean delay, as range, that the floor's roughness adds at each bounce [m]."""
    late_db: float = -20.0
    """Share of the object's echo that comes back late and diffuse [dB]."""
    late_m: float = 0.4
    """Range over which late reverberation decays to 1/e [m]."""
    glint_db: float = 12.0
    """Power of the glint, if the frame has one, over the largest mean power of any cell of the frame [dB].

    A cell is one range sample of one sub-beam; the glint fills one cell, and does not fluctuate. Power is that of all
    echoes together, before speckle, pulse, beam pattern and gain.
    """
    glint_chance: float = 0.1
    """Chance of a glint in a frame in which some face is struck squarely (see `sensor.SQUARE`) [1]."""

    @classmethod
    def nominal(cls, severity: float = 1.0) -> Device:
        """A DIDSON in a tank; `severity` scales the amplitude of all that disturbs, 1 is usual."""
        return _scaled(cls(), severity)

    @classmethod
    def draw(cls, rng: np.random.Generator, severity: float = 1.0) -> Device:
        """Some other device in some other tank, as they come."""
        device = cls(
            beam_width_ratio=rng.uniform(0.9, 1.6),
            both_ways=bool(rng.random() < 0.5),
            conical=bool(rng.random() < 0.5),
            stray_db=rng.uniform(-60, -42),
            skirt_db_per_deg=rng.uniform(10, 14),
            droop_db=rng.uniform(0.5, 2.5),
            pulse_m=rng.uniform(0.005, 0.014),
            looks=int(rng.choice([1, 1, 2])),
            crosstalk_db=rng.uniform(-45, -28),
            firing_period=int(rng.choice([4, 8, 16])),
            gain_exponent=rng.uniform(2, 4),
            gain_slope_db_m=rng.normal(0, 1.5),
            assumed_absorption=rng.uniform(0.5, 1.5),
            noise_db=rng.uniform(-24, -12),
            automatic_gain=rng.uniform(0, 0.5),
            sound_speed_ratio=1 + rng.normal(0, 0.002),
            temperature_c=rng.uniform(8, 20),
            object_db=rng.uniform(1, 7),
            gloss_db=rng.uniform(3, 13),
            gloss_deg=rng.uniform(5, 14),
            patch_db=rng.uniform(0.5, 3),
            patch_m=rng.uniform(0.1, 0.5),
            ripple=rng.uniform(0.2, 0.6) if rng.random() < 0.3 else 0.0,
            ripple_m=rng.uniform(0.04, 0.15),
            texture_shape=float(np.exp(rng.uniform(np.log(2), np.log(20)))),
            grain_m=rng.uniform(0.01, 0.04),
            bounce_db=rng.uniform(-20, -9),
            bounce_spread_m=rng.uniform(0.002, 0.012),
            late_db=rng.uniform(-27, -17),
            late_m=rng.uniform(0.2, 0.8),
            glint_db=rng.uniform(6, 18),
            glint_chance=rng.uniform(0, 0.3),
        )
        return _scaled(device.with_drawn_law(rng), severity)

    def with_drawn_law(self, rng: np.random.Generator) -> Device:
        """The same device with one of the three display laws, at a setting within what operators use."""
        return replace(
            self,
            law=str(rng.choice(["db", "power", "arctan"])),
            range_db=rng.uniform(35, 60),
            gamma=rng.uniform(0.5, 1.0),
            floor_grey=rng.uniform(0.25, 0.45),
        )


_LEVELS = ("stray_db", "crosstalk_db", "noise_db", "bounce_db", "late_db", "glint_db")
_SPREADS = ("gain_slope_db_m", "patch_db", "ripple")


def _scaled(device: Device, severity: float) -> Device:
    """`severity` times the amplitude of everything that disturbs; the object stands out less by as much."""
    if severity <= 0:
        raise ValueError(f"severity must be positive, got {severity}")
    louder = 20 * np.log10(severity)
    changes: dict[str, float] = {name: getattr(device, name) + louder for name in _LEVELS}
    changes |= {name: getattr(device, name) * severity for name in _SPREADS}
    changes["ripple"] = min(changes["ripple"], 0.9)  # beyond 1 the floor would send back less than nothing
    return replace(
        device, **changes, object_db=device.object_db - louder, texture_shape=device.texture_shape / severity
    )
