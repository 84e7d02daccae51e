"""Order: BIC with gates decides; the table says why each other order was refused."""

from simulated_beam import film

from beam_ident import identify, select_transfer_function

record = film(1)
result = identify(record)
print("modes   BIC        worst FIT   chosen")
for entry in result.orders:
    print(f"{entry.n_modes:>5}   {entry.bic:>9.1f}   {entry.worst_fit_percent:>8.2f} %", end="")
    print("   chosen" if entry.is_chosen else f"   {entry.refused_because}")

# Transfer functions from hub to tip: YIC stands in the table and decides nothing.
selection = select_transfer_function(record.select(["tip"]), n_poles=(2, 4), n_zeros=(2, 4))
print("poles zeros   R_T^2      YIC       BIC")
for row in selection.table:
    print(f"{row.n_poles:>5} {row.n_zeros:>5}   {row.r_squared:.6f}  {row.yic:>7.2f} {row.bic:>9.1f}", end="")
    print("   chosen" if row.is_chosen else f"   {row.refused_because}")
