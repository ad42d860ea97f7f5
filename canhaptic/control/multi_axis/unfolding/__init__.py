"""One function of plain numbers from the classes that render: what the extra `fast` compiles.

No formula is written here a second time. The methods of a controller are read from their source and walked once, from
`step` on, with the very objects of that controller: calls are put in place, loops over its axes, ports and states are
written out, what its parameters fix is computed now, and attributes that change become entries of one array. What is
left is straight code with the branches that data decide (`statements`, `expressions`, `calls`).

Where a branch would change the shape of the state (a pose outside the workspace has no coordinates) or raises, the
function undoes what it did and says so: that step is made by the interpreted controller, which then hands its state
back (`memory`).
"""
