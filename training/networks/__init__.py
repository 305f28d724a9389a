"""Networks of the paper and their baselines, as torch modules.

``push_network`` is the masked and concatenated networks, ``encoders`` encodes their contexts, and ``neural_process`` is
the attentive neural process with its ``attention``. ``mechanics`` pushes any outline from the first ``contact`` on.
``angles`` and ``mixed_precision`` hold arithmetic, and ``methods`` lists the rows of the paper's tables. Calls point
downward: of the trainer, this package imports ``omnipush`` alone.
"""
