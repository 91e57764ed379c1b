"""CasADi's instructions in heyoka's terms, one by one."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX, Function

hy = pytest.importorskip("heyoka")

from gaitopt.simulation.heyoka_code import BINARY, UNARY, convert  # noqa: E402

ROUNDING = 1e-15


def evaluated(function, inputs, constants=()):
    """Values of a converted function: variables from ``inputs``, constants as runtime parameters."""
    names = [[hy.expression(f"v{k}_{i}") for i in range(v.size)] for k, v in enumerate(inputs)]
    conversion = convert(function, dict(enumerate(names)))
    outputs = [entry for output in conversion.outputs for entry in output]
    variables = [name for group in names for name in group]
    compiled = hy.cfunc(outputs, variables, compact_mode=True, opt_level=0)
    values = np.concatenate(inputs)
    if not conversion.constants.numel_out(0):
        return compiled(values)
    return compiled(values, pars=np.asarray(conversion.constants(*constants), dtype=float).ravel())


@pytest.mark.parametrize("operation", [*sorted(UNARY), *sorted(BINARY)])
def test_instruction_has_the_same_value(operation):
    x, y = SX.sym("x"), SX.sym("y")
    at = (1.3, 1.9) if operation == ca.OP_ACOSH else (0.3, 1.9)
    value = SX.unary(operation, x) if operation in UNARY else SX.binary(operation, x, y)
    function = Function("f", [x, y], [value])
    assert evaluated(function, [*map(np.atleast_1d, at)])[0] == pytest.approx(float(function(*at)), rel=10 * ROUNDING)


@pytest.mark.parametrize("kinked", [ca.fabs, ca.sign, ca.floor])
def test_instruction_with_a_kink_is_refused_by_the_function_that_holds_it(kinked):
    x = SX.sym("x")
    with pytest.raises(ValueError, match=r"wobble: CasADi's operation .* engine scipy"):
        convert(Function("wobble", [x], [kinked(x)]), {0: [hy.expression("x")]})


def test_kink_in_constants_alone_is_no_hindrance():
    x, p = SX.sym("x"), SX.sym("p")
    function = Function("f", [x, p], [x * ca.fabs(p)])
    assert evaluated(function, [np.array([2.0])], [-3.0])[0] == 6.0


def test_structural_zeros_of_an_output_stay_zero():
    x = SX.sym("x")
    output = SX(3, 1)
    output[1] = x
    conversion = convert(Function("f", [x], [output]), {0: [hy.expression("x")]})
    assert [str(entry) for entry in conversion.outputs[0]][::2] == ["0.0000000000000000", "0.0000000000000000"]


def test_each_value_of_constants_is_handed_over_once():
    x, p = SX.sym("x"), SX.sym("p")
    product = ca.sin(p) * p
    conversion = convert(Function("f", [x, p], [product * x, product + x]), {0: [hy.expression("x")]})
    assert conversion.constants.numel_out(0) == 1
