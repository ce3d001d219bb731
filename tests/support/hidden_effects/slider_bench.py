"""A slider pulled by a spring, integrated by velocity Verlet; no closed form is used."""

import numpy as np
import pandas as pd

G = 9.81  # m/s², as docs/how/physics.md states it
SPRINGS_N_M = (60.0, 200.0, 600.0)
SPEEDS_MM_S = (0.5, 2.0, 8.0)
ADDED_G = (20.0, 60.0, 150.0)
SLIPS = 18
STEPS_A_PERIOD = 200
SAMPLES_A_PERIOD = 20
LONGEST_SLIP_PERIODS = 25  # a slider that never stops has shown enough by then


def pulled(spring, mass, speed, static, kinetic, slips=SLIPS):
    """Times and spring forces (piecewise linear) from a relaxed spring to the last slip.

    ``static`` is a function of the time that the slider has stuck and of its place, ``kinetic``
    of its place.
    """
    step = 2 * np.pi * np.sqrt(mass / spring) / STEPS_A_PERIOD
    time = place = force = 0.0
    times, forces = [0.0], [0.0]
    stuck_since, count = 0.0, 0
    while count < slips:
        low, high = 0.0, 1e5
        for _ in range(80):  # when the growing pull meets the growing static friction
            middle = 0.5 * (low + high)
            pull = force + spring * speed * middle
            if pull >= static(time + middle - stuck_since, place):
                high = middle
            else:
                low = middle
        time += high
        force += spring * speed * high
        times.append(time)
        forces.append(force)
        velocity = 0.0
        push = max(force - kinetic(place), 0.0) / mass
        for _ in range(LONGEST_SLIP_PERIODS * STEPS_A_PERIOD):
            velocity += 0.5 * step * push
            place += step * velocity
            force += spring * step * (speed - velocity)
            push = (force - kinetic(place)) / mass
            velocity += 0.5 * step * push
            time += step
            times.append(time)
            forces.append(force)
            if velocity <= 0.0 and force <= kinetic(place):
                break
        else:
            break
        stuck_since = time
        count += 1
    return np.array(times), np.array(forces)


def spring_slider(rng, world, noise, common, switch):
    """Tables of the protocol: ``common`` holds the common columns of a run table."""
    table = common
    n = len(table)
    table["stage_azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    table["area_cm2"] = rng.choice([25.0, 50.0], n)
    table["added_mass_g"] = rng.choice(ADDED_G, n)
    table["spring_N_m"] = rng.choice(SPRINGS_N_M, n)
    table["speed_mm_s"] = rng.choice(SPEEDS_MM_S, n)
    table["u_force_mN"] = noise["u_force"]
    traces = []
    rows = world.rows(table, "spring_slider")
    for i, run_id in enumerate(table["run_id"]):
        row = {name: values[i] for name, values in rows.items()}
        mass = world.rho * row["area_m2"] + row["added_kg"]
        load = mass * G
        slope = load * np.sin(world.downhill(row["azimuth_deg"]))
        knots = np.cumsum(rng.exponential(noise["texture_length"] * 1e-3, 400))
        uneven = 1 + switch * noise["texture"] * rng.standard_normal(400)
        moving = float(world.friction(row, load, True))

        def at(place, knots=knots, uneven=uneven):
            return float(np.interp(place, knots, uneven))

        def static(stuck_s, place, row=row, load=load, at=at, slope=slope):
            rest = stuck_s + (row["dwell_s"] if place == 0.0 else 0.0)
            return float(world.friction(row, load, False, dwell_s=rest)) * at(place) - slope

        def kinetic(place, moving=moving, at=at, slope=slope):
            return moving * at(place) - slope

        spring = row["spring_N_m"]
        times, forces = pulled(spring, mass, row["speed_mm_s"] * 1e-3, static, kinetic)
        period = 2 * np.pi * np.sqrt(mass / spring)
        seen = np.arange(0, times[-1], max(period / SAMPLES_A_PERIOD, times[-1] / 20_000))
        force = 1e3 * np.interp(seen, times, forces) * (1 + world.get("force_gain"))
        force = force + world.get("force_offset")
        force = force + switch * noise["u_force"] * noise["understated"] * (
            rng.standard_normal(len(seen))
        )
        traces.append(
            pd.DataFrame({"run_id": run_id, "t_s": seen.round(5), "force_mN": force.round(4)})
        )
    return {"spring_slider_runs": table, "spring_slider": pd.concat(traces, ignore_index=True)}
