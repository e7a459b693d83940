"""How much every cell of the paper's tables depends on what was decided, or is not known well.

Each variation changes one thing: a rule of the model, the tissue's thickness, the needle's rigidity, the
depths of all layers. Everything is then tuned again and scored under it, which is what another program, with
another reading of the paper, would have printed; and scored with the parameters kept, which is what taking
numbers from one program to the other would do. Two of them have known answers: parameters and rigidity
enter the equilibrium by their ratio, so that a stiffer needle is answered by moduli stiffer by as much, and
no error changes; and at the strains of these needles thickness hardly acts.
"""
