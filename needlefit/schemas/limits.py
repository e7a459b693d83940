"""How large an input may be: far above real use, and small enough for the memory of one machine."""

MAX_NUMBER = 1e15  #: largest number in a file or message: products of up to twenty of them stay finite
MAX_NEEDLE_LENGTH_MM = 5000.0  #: largest length (mm): needles, catheters and guide wires have up to about 2 m
#: largest diameter (mm): one in micrometres is below it, so that its unit is named in a warning
MAX_NEEDLE_DIAMETER_MM = 10_000.0
#: smallest element and smallest constraint spacing (mm); below, rounding exceeds the discretisation error
MIN_ELEMENT_MM = 0.05
#: largest constraint spacing (mm): the model takes 1 mm; elements fill a cell however long it is, and so do
#: time and memory
MAX_CONSTRAINT_SPACING_MM = 10.0
#: largest number of elements in the tissue: 5 m in elements of 1 mm, 250 mm in those of 0.05 mm
MAX_ELEMENTS = 5000
#: largest number of elements solved for in all equilibria of an insertion; one to `MAX_ELEMENTS` without a
#: halt has as many
MAX_ELEMENT_SOLVES = 12_500_000
#: largest number of these for all insertions that one evaluation of a fit simulates
MAX_EVALUATION_ELEMENT_SOLVES = 50_000_000
MAX_STEPS = 10_000  #: largest number of steps of a scene, and of rays that an interactive needle may have cut
MAX_LAYERS = 200  #: largest number of layers of a tissue or medium
MAX_GUIDES = 50  #: largest number of guides of a scene
MAX_ITERATIONS = 200  #: largest number of iterations of Newton's method in one equilibrium
MAX_STARTS = 10_000  #: largest number of starts of a search
MAX_EVALUATIONS = 10_000_000  #: largest number of evaluations of one start
MAX_WALKERS = 2000  #: largest number of walkers of a sampler
#: largest number of densities of a sampler: a draw of ten parameters takes 80 bytes, and there are copies
MAX_DENSITIES = 1_000_000
MAX_SEED = 2**63 - 1  #: largest seed of random numbers: the largest whole number of a TOML file
