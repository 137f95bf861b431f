"""Optimal compensations, and the certificate that proves them."""

from optkit.models.pricing.certificate import PriceCertificate, certify
from optkit.models.pricing.optimal import Pricing, optimal_prices

__all__ = ["PriceCertificate", "Pricing", "certify", "optimal_prices"]


def __dir__() -> list[str]:
    return sorted(__all__)
