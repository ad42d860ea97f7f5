"""Sums of products, and linear equations in place: the few states of a network, factored at every step of Newton."""

from canhaptic.kernels import Buffer, Matrix


def dot(row: Buffer, vector: Buffer) -> float:
    """Return the product of a row and a vector of the same length, summed from the first entry on."""
    total = 0.0
    for i in range(len(row)):
        total += row[i] * vector[i]
    return total


def solve_linear(matrix: Matrix, right: Buffer) -> bool:
    """Solve in place by elimination with row pivots; return False where the matrix is singular."""
    n = len(right)
    for column in range(n):
        pivot = column  # the row, from the diagonal down, with the largest entry
        for index in range(column + 1, n):
            if abs(matrix[index][column]) > abs(matrix[pivot][column]):
                pivot = index
        if not abs(matrix[pivot][column]) > 0.0:
            return False
        if pivot != column:
            for k in range(column, n):
                matrix[pivot][k], matrix[column][k] = matrix[column][k], matrix[pivot][k]
            right[pivot], right[column] = right[column], right[pivot]
        _eliminate(matrix, right, column)
    for back in range(n):
        index = n - 1 - back
        row, total = matrix[index], right[index]
        for k in range(index + 1, n):
            total -= row[k] * right[k]
        right[index] = total / row[index]
    return True


def _eliminate(matrix: Matrix, right: Buffer, column: int) -> None:
    """Take a column out of all rows below its diagonal."""
    n, above = len(right), matrix[column]
    for index in range(column + 1, n):
        row = matrix[index]
        if row[column] != 0.0:
            factor = row[column] / above[column]
            for k in range(column + 1, n):
                row[k] -= factor * above[k]
            right[index] -= factor * right[column]
