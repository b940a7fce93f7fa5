"""Outcomes of the search for a motion of least cost."""

from __future__ import annotations

from enum import Enum

__all__ = ["STATUSES", "ControlStatus"]


class ControlStatus(Enum):
    """How the search for a solution ended, with a sentence that says so."""

    SOLVED = "A local optimum was found."
    ACCEPTABLE = "An optimum was found, less exactly than was asked for."
    INFEASIBLE = (
        "The solver came to a point where the conditions cannot be satisfied better nearby. "
        "Another guess, wider bounds or a longer duration may help."
    )
    ITERATION_LIMIT = "The solver used all its iterations. Allow more, or begin nearer."
    RESTORATION_FAILED = (
        "The solver could not go on from where it is. A tolerance below 1e-11 asks for more than "
        "rounding allows; else another guess may help."
    )
    NOT_RESOLVED = (
        "The equations of steps are solved, but between the points at which they see forces, "
        "costs and constraints the motion, or its cost, is another one: inputs chatter from node "
        "to node, steps are too long, what is dear lies between nodes, or the path jumps to "
        "another branch of the constraints. Take more steps, a Gauss "
        "scheme such as 'gauss6' where inputs act on velocities, or a guess that follows the "
        "constraints from start to end."
    )
    NOT_OPTIMAL = (
        "The conditions are satisfied, but the cost falls further nearby, or multipliers without "
        "bound do not tell: some conditions follow from others, or touch them. Leave out what "
        "follows, give in full what is known of an end, or begin at another guess."
    )
    NO_MASS = (
        "The equations of steps are solved, but the mass matrix is not positive definite on the "
        "way: what has no mass follows no force. Check the masses, and bound those that are found."
    )
    INTERRUPTED = "The search was interrupted; the last iterate is kept."
    NOT_FINITE = "An energy, force or cost had no value on the way. Bound what must not be reached."


#: What they are in the words of Ipopt.
STATUSES = {
    "Solve_Succeeded": ControlStatus.SOLVED,
    "Solved_To_Acceptable_Level": ControlStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": ControlStatus.INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": ControlStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": ControlStatus.ITERATION_LIMIT,
    "User_Requested_Stop": ControlStatus.INTERRUPTED,
    "Invalid_Number_Detected": ControlStatus.NOT_FINITE,
}
