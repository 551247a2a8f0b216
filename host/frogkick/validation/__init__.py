"""The model beside measured swims, and over every gait."""
