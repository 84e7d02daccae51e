"""Validation: prediction of another record, residuals, and whether repeated records agree."""

from simulated_beam import film

from beam_ident import PointToPoint, assess_repeatability, identify, validate

models = [identify(film(seed), n_modes=2).model for seed in range(1, 5)]

# A move that the model has never seen.
move = PointToPoint(waypoints=(0.002, -0.001, 0.0), speed=0.03, acceleration=0.4, dwell=1.0, still=3.0)
unseen = film(10, recipe=move)
for output in validate(models[0], unseen).outputs:
    print(f"{output.name}: {output.verdict}")
    # Near the hub nearly everything is the hub's own motion: the deflection tells more.
    print(
        f"  FIT {output.scores.fit_percent:.2f} %, of the deflection {output.deflection_scores.fit_percent:.2f} %"
    )

# Four records of one beam: do the estimates scatter as much as they say?
study = assess_repeatability(models)
print(study.verdict)
for parameter in study.parameters:
    print(
        f"  {parameter.name}: {parameter.mean:.6g} +- {parameter.mean_sd:.2g}, scatter x {parameter.ratio:.2f}"
    )

# A beam that changed between the records is told from one that did not.
heavier = models[0].to_dict()
heavier["natural_frequencies_rad_s"][0] *= 0.9999
print(assess_repeatability([type(models[0]).from_dict(heavier), *models[1:]]).verdict)
